import type { Point } from "./projection";

export type Direction = "ArrowLeft" | "ArrowRight" | "ArrowUp" | "ArrowDown";

const WAYS: Record<Direction, Point> = {
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
  ArrowUp: [0, -1],
  ArrowDown: [0, 1],
};
const ASIDE = 2; // how much farther a step aside counts than one ahead

/** The place that is nearest to a point; null without any. */
export function nearestTo(point: Point, places: ReadonlyMap<number, Point>): number | null {
  return least(places, ([x, y]) => Math.hypot(x - point[0], y - point[1]));
}

/** The next place from one of them in a direction of the picture, by its id; null where there is none. */
export function nextIn(direction: Direction, from: number, places: ReadonlyMap<number, Point>): number | null {
  const [begin, [wayX, wayY]] = [places.get(from), WAYS[direction]];
  if (!begin) return null;
  return least(places, ([x, y]) => {
    const [dx, dy] = [x - begin[0], y - begin[1]];
    const [ahead, aside] = [dx * wayX + dy * wayY, Math.abs(dx * wayY + dy * wayX)];
    return ahead > 0 ? ahead + ASIDE * aside : Infinity;
  });
}

function least(places: ReadonlyMap<number, Point>, cost: (place: Point) => number): number | null {
  let [best, lowest]: [number | null, number] = [null, Infinity];
  for (const [id, place] of places) {
    const value = cost(place);
    if (value < lowest) [best, lowest] = [id, value];
  }
  return best;
}
