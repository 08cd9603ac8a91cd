import { describe, expect, test } from "vitest";

import type { Gesture } from "./cameraBound";
import { CameraBound } from "./cameraBound";
import type { LookAt } from "./poses";
import { axesOf, cameraOf, firstView, fly, focalLength, orbit, turn, zoom } from "./poses";
import { random } from "./random.fixture";
import { sightingsOf } from "./seenField";
import type { SplatColumns } from "./spz";
import type { Vec } from "./vectors";
import { add, dot, length, scale, subtract, unit } from "./vectors";

/** A rectangle: its middle, its half sides as vectors. */
type Wall = readonly [Vec, Vec, Vec];

const ROOM: readonly Wall[] = [
  [
    [0, 0, 0],
    [4, 0, 0],
    [0, 4, 0],
  ], // floor
  [
    [0, 3, 1.5],
    [4, 0, 0],
    [0, 0, 1.5],
  ], // the wall behind
  [
    [-3, 0, 1.5],
    [0, 4, 0],
    [0, 0, 1.5],
  ],
  [
    [3, 0, 1.5],
    [0, 4, 0],
    [0, 0, 1.5],
  ],
  [
    [0, 0, 0.8],
    [0.8, 0, 0],
    [0, 0.5, 0],
  ], // a table's top
  [
    [0, -0.5, 0.4],
    [0.8, 0, 0],
    [0, 0, 0.4],
  ], // and its front
];
const SPACING = 0.12;
const ASPECT = 4 / 3;
const photos = [-50, -35, -20, -5, 10, 25, 40, 55].map((degrees) => {
  const angle = (degrees * Math.PI) / 180;
  const position: Vec = [2.4 * Math.sin(angle), -2.4 * Math.cos(angle), 1.6];
  return cameraOf({ position, target: [0, 0.4, 0.6], up: [0, 0, 1] }, 640, 480);
});

/** Gaussians on all the walls. */
function painted(): SplatColumns {
  const points = ROOM.flatMap(([middle, one, other]) => {
    const [across, along] = [length(one) / SPACING, length(other) / SPACING].map(Math.floor) as [number, number];
    const all: Vec[] = [];
    for (let a = -across; a <= across; a++)
      for (let b = -along; b <= along; b++) all.push(add(middle, add(scale(one, a / across), scale(other, b / along))));
    return all;
  });
  const same = (value: number) => new Float32Array(points.length).fill(value);
  const columns = new Map<string, Float32Array>([
    ...(["x", "y", "z"] as const).map((name, axis) => [name, Float32Array.from(points, (p) => p[axis] ?? 0)] as const),
    ...["scale_0", "scale_1", "scale_2"].map((name) => [name, same(Math.log(SPACING / 2))] as const),
    ["opacity", same(4)],
  ]);
  return { count: points.length, columns };
}

/** A splat with a curtain of faint Gaussians, half a unit before a view. */
function veiled({ count, columns }: SplatColumns, view: LookAt, logit: number): SplatColumns {
  const { right, down, forward } = axesOf(view);
  const middle = add(view.position, scale(forward, 0.5));
  const all = Array.from({ length: 441 }, (_, at) =>
    add(middle, add(scale(right, ((at % 21) - 10) / 25), scale(down, (Math.floor(at / 21) - 10) / 25))),
  );
  const more: Record<string, readonly number[]> = {
    ...Object.fromEntries(["x", "y", "z"].map((name, axis) => [name, all.map((point) => point[axis] ?? 0)])),
    opacity: all.map(() => logit),
  };
  const added = [...columns].map(([name, own]) => {
    const values = more[name] ?? all.map(() => Math.log(0.05));
    return [name, Float32Array.from([...own, ...values])] as const;
  });
  return { count: count + all.length, columns: new Map(added) };
}

/** Where a ray first meets a wall, from which side, or null. */
function hit(from: Vec, way: Vec): { point: Vec; wall: Wall; front: boolean; distance: number } | null {
  let nearest: ReturnType<typeof hit> = null;
  for (const wall of ROOM) {
    const [middle, one, other] = wall;
    const normal = unit([
      one[1] * other[2] - one[2] * other[1],
      one[2] * other[0] - one[0] * other[2],
      one[0] * other[1] - one[1] * other[0],
    ]);
    const slope = dot(way, normal);
    const distance = dot(subtract(middle, from), normal) / slope;
    if (!(distance > 1e-4) || (nearest && distance >= nearest.distance)) continue;
    const point = add(from, scale(way, distance));
    const offset = subtract(point, middle);
    if (Math.abs(dot(offset, one)) > dot(one, one) || Math.abs(dot(offset, other)) > dot(other, other)) continue;
    nearest = { point, wall, front: slope < 0, distance };
  }
  return nearest;
}

/** The rays of a picture's cells. */
function raysOf(view: LookAt, columns: number, rows: number): Vec[] {
  const { right, down, forward } = axesOf(view);
  const focal = focalLength(columns, rows, view.fieldOfView);
  return Array.from({ length: columns * rows }, (_, cell) => {
    const [u, v] = [(cell % columns) + 0.5 - columns / 2, Math.floor(cell / columns) + 0.5 - rows / 2];
    return unit(add(forward, add(scale(right, u / focal), scale(down, v / focal))));
  });
}

/** How much of a picture shows sides of walls, at places that two photos show: by rays, with nothing of the page's. */
function covered(view: LookAt): number {
  const rays = raysOf(view, 24, 18);
  const seen = rays.filter((way) => {
    const met = hit(view.position, way);
    if (!met) return false;
    return photos.filter((photo) => isIn(photo, met)).length >= 2;
  });
  return seen.length / rays.length;
}

function isIn(photo: (typeof photos)[number], { point, wall, front }: NonNullable<ReturnType<typeof hit>>): boolean {
  const eye: Vec = [photo.position.x, photo.position.y, photo.position.z];
  const { right, down, forward } = axesOf({ position: eye, target: [0, 0.4, 0.6], up: [0, 0, 1] });
  const offset = subtract(point, eye);
  const depth = dot(offset, forward);
  const { fx, width, height } = photo.intrinsics;
  if (depth <= 0 || Math.abs((dot(offset, right) / depth) * fx) > width / 2) return false;
  if (Math.abs((dot(offset, down) / depth) * fx) > height / 2) return false;
  const met = hit(eye, unit(offset));
  return met !== null && met.wall === wall && met.front === front && Math.abs(met.distance - length(offset)) < 0.01;
}

function someGesture(view: LookAt, next: () => number): Gesture {
  const [a, b] = [next() * 2 - 1, next() * 2 - 1];
  const kinds: Gesture[] = [
    (share) => orbit(view, a * share, 0.5 * b * share),
    (share) => fly(view, 0.4 * a * share, 0.4 * b * share, 0),
    (share) => fly(view, 0, 0, 0.3 * a * share),
    (share) => zoom(view, Math.exp(0.6 * a * share)),
    (share) => turn(view, 0.5 * a * share, 0.3 * b * share),
  ];
  return kinds[Math.floor(next() * kinds.length)] ?? ((share) => orbit(view, a * share, 0));
}

describe("the camera stays where pictures show what photos have seen", () => {
  const bound = new CameraBound(sightingsOf(painted(), photos), photos, () => ASPECT);

  test("the first view and 200 gestures are covered to 60 % by what two photos show", () => {
    expect(bound.floor).toBeGreaterThan(0.5);
    const next = random(7);
    let view = firstView(photos);
    let [lowest, moves, free] = [covered(view), 0, 0];
    const headings: number[] = [];
    for (let round = 0; round < 200; round++) {
      const gesture = someGesture(view, next);
      if (covered(gesture(1)) < 0.6) free += 1;
      const after = bound.bounded(gesture);
      if (length(subtract(after.position, view.position)) > 0.01) moves += 1;
      view = after;
      lowest = Math.min(lowest, covered(view));
      headings.push(Math.atan2(view.position[0], -view.position[1]));
    }
    expect(lowest).toBeGreaterThanOrEqual(0.6);
    expect(free).toBeGreaterThan(20); // gestures that would have left it
    expect(moves).toBeGreaterThan(80); // and the camera is no prisoner
    expect(Math.max(...headings) - Math.min(...headings)).toBeGreaterThan(0.8);
  });

  test("behind a wall nothing was seen, and every way back is free", () => {
    const outside: LookAt = { position: [0, 6, 1.5], target: [0, 0.4, 0.6], up: [0, 0, 1] };
    expect(bound.showsNothing(outside)).toBe(true);
    expect(bound.showsNothing(firstView(photos))).toBe(false);
    const back = bound.bounded((share) => (share < 1 ? outside : firstView(photos)));
    expect(back).toEqual(firstView(photos));
  });

  test("of a gesture that left it, as much is kept as shows what was seen", () => {
    const first = firstView(photos);
    const around: Gesture = (share) => orbit(first, Math.PI * share, 0);
    const kept = bound.farthest(around);
    expect(covered(around(1))).toBeLessThan(0.6);
    expect(covered(kept)).toBeGreaterThanOrEqual(0.6);
    expect(length(subtract(kept.position, first.position))).toBeGreaterThan(0.3);
    const little: Gesture = (share) => orbit(first, 0.05 * share, 0);
    expect(bound.farthest(little)).toEqual(little(1));
  });

  test("where fog that photos look past hides what they show, the camera does not stay", () => {
    const view: LookAt = { position: [1.2, -2.2, 1.6], target: [0, 0.4, 0.6], up: [0, 0, 1] };
    const shownThrough = (logit: number) => {
      const seen = sightingsOf(veiled(painted(), view, logit), photos);
      return new CameraBound(seen, photos, () => ASPECT).shows(view);
    };
    expect(bound.shows(view)).toBe(true);
    expect(shownThrough(-2)).toBe(false); // each lets 88 % of the light through
    expect(shownThrough(-4.5)).toBe(true); // each 99 %
  });

  test("a scene without photos bounds nothing", () => {
    const free = new CameraBound(sightingsOf(painted(), []), [], () => ASPECT);
    const far: LookAt = { position: [0, 60, 1.5], target: [0, 0, 0], up: [0, 0, 1] };
    expect(free.bounded((share) => (share < 1 ? firstView(photos) : far))).toEqual(far);
    expect(free.showsNothing(far)).toBe(false);
  });
});
