import type { PosedCamera } from "../api/types";
import type { LookAt } from "./poses";
import { focalLength, rayOf, upOf } from "./poses";
import type { Size } from "./projection";
import { Projection } from "./projection";
import type { Vec } from "./vectors";
import { add, dot, length, mix, scale, subtract, unit } from "./vectors";

/** What is flown to: its middle, its longest side, and the cameras that show it best, where that is known. */
export interface Sight {
  middle: Vec;
  size: number;
  views?: readonly string[] | undefined;
}

const OF_HEIGHT = 1 / 3; // how much of the picture's height an object is to take
const OF_WIDTH = 2 / 3; // and at most of its width, where that is much less than the height
const AROUND = 1.25; // of half its longest side: corners are farther out, and what is nearer looks larger
const [NEAREST, FARTHEST] = [0.5, 1.1]; // of the photo's distance: nearer it is blurred, farther nobody has been
const TURNS = [0, 0.25, 0.5, 0.75, 1]; // of the way from the object to where the photo looked
const ASIDE = 4; // how much a turn of the head counts against a way

/**
 * Looks at something from where a photo of it was taken, so that it takes a third of the height: on the line from that
 * camera to it, which is free, since the photo shows it.
 *
 * @param shown whether a view shows what was seen: if not, the head turns to where the photo looked, as far as it must,
 *   and no farther than the picture shows the object whole, if it can.
 */
export function viewOfSight(
  sight: Sight,
  cameras: readonly PosedCamera[],
  now: LookAt,
  size: Size,
  shown: (view: LookAt) => boolean = () => true,
): LookAt {
  const best = sight.views?.flatMap((name) => cameras.filter((camera) => camera.name === name))[0];
  const camera = best ?? facing(sight.middle, cameras);
  const from = camera ? rayOf(camera).position : now.position;
  const offset = subtract(from, sight.middle);
  const photo = length(offset);
  const focal = focalLength(Math.max(size.width, 1), Math.max(size.height, 1));
  const wanted =
    (focal * sight.size) / Math.min(OF_HEIGHT * Math.max(size.height, 1), OF_WIDTH * Math.max(size.width, 1));
  const distance = camera ? Math.min(FARTHEST * photo, Math.max(NEAREST * photo, wanted)) : wanted;
  const up = cameras.length ? upOf(cameras) : (now.level ?? now.up);
  const view = { up, target: sight.middle, position: add(sight.middle, scale(unit(offset), distance)) };
  if (!camera) return view;
  const ahead = add(view.position, scale(rayOf(camera).forward, distance));
  const turned = TURNS.map((share) => ({ ...view, target: mix(view.target, ahead, share) }));
  const whole = turned.filter((each) => showsWhole(each, sight, size));
  return (whole.length ? (whole.find(shown) ?? whole.at(-1)) : turned.find(shown)) ?? view;
}

/** Whether a picture shows all of an object, however it is turned. */
function showsWhole(view: LookAt, { middle, size: across }: Sight, size: Size): boolean {
  const point = new Projection(view, size).point(middle);
  const depth = dot(subtract(middle, view.position), unit(subtract(view.target, view.position)));
  const radius = (focalLength(size.width, size.height, view.fieldOfView) * AROUND * across) / 2 / depth;
  if (!point) return false;
  const room = Math.min(point[0], size.width - point[0], point[1], size.height - point[1]);
  return room >= radius;
}

/** The camera that has a place near the middle of its picture, from nearby. */
function facing(middle: Vec, cameras: readonly PosedCamera[]): PosedCamera | null {
  let [best, lowest]: [PosedCamera | null, number] = [null, Infinity];
  for (const camera of cameras) {
    const { position, forward } = rayOf(camera);
    const offset = subtract(middle, position);
    const aside = Math.acos(Math.min(1, Math.max(-1, dot(unit(offset), forward))));
    const cost = length(offset) * (1 + ASIDE * aside * aside);
    if (cost < lowest) [best, lowest] = [camera, cost];
  }
  return best;
}
