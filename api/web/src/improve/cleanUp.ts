import type { CleanUpEdit, GaussianFilter } from "../api/cleanUpCalls";
import type { PosedCamera } from "../api/types";
import { centerOfAttention, firstView } from "../viewer/poses";
import { drawnDepth } from "../viewer/projection";
import type { Vec } from "../viewer/vectors";
import { add, cross, scale, unit } from "../viewer/vectors";

/** A box whose third axis is up; `low` and `high` are along its axes from its origin, in scene units. */
export interface CropBox {
  origin: Vec;
  axes: readonly [Vec, Vec, Vec];
  low: Vec;
  high: Vec;
}

/** What is to be cleaned up: 0 and null where nothing is. */
export interface CleanUp {
  /** Gaussians that are fainter go. */
  opacity: number;
  /** Gaussians that are more than so many times as far from others as usual go. */
  isolation: number;
  box: CropBox | null;
  /** Whether what is outside of the box goes, or what is inside. */
  outside: boolean;
  /** Objects that go with all that is theirs. */
  objects: readonly number[];
}

export const NOTHING: CleanUp = { opacity: 0, isolation: 0, box: null, outside: true, objects: [] };

/** The edits that clean up, one a control: each takes what it says of what those before it have left. */
export function editsOf({ opacity, isolation, box, outside, objects }: CleanUp): CleanUpEdit[] {
  const filters: GaussianFilter[] = [];
  if (opacity > 0) filters.push({ opacity_below: opacity, outside: false });
  if (isolation > 0) filters.push({ isolation_above: isolation, outside: false });
  if (box) filters.push({ box: placed(box), outside });
  return [
    ...(objects.length > 0 ? [{ action: "remove" as const, object_ids: [...objects] }] : []),
    ...filters.map((filter) => ({ action: "remove" as const, filter })),
  ];
}

/** A box around what the photos look at, large enough for what stands there. */
export function boxAround(cameras: readonly PosedCamera[]): CropBox {
  const up = firstView(cameras).up;
  // Where up is z, these are the axes of the world.
  const first = unit(cross(Math.abs(up[1]) < 0.9 ? [0, 1, 0] : [1, 0, 0], up));
  const reach = reachOf(cameras) / 2;
  return {
    origin: centerOfAttention(cameras),
    axes: [first, cross(up, first), up],
    low: [-reach, -reach, -reach],
    high: [reach, reach, reach],
  };
}

/** How far a box may reach from its origin: as far as photos were usually taken from there, twice. */
export function reachOf(cameras: readonly PosedCamera[]): number {
  return 2 * 10 * drawnDepth(cameras);
}

/** A point of the box's frame in the world. */
function inWorld({ origin, axes }: CropBox, [x, y, z]: Vec): Vec {
  return add(origin, add(scale(axes[0], x), add(scale(axes[1], y), scale(axes[2], z))));
}

/** The twelve edges of a box, each from and to a point of the world. */
export function edgesOf(box: CropBox): [Vec, Vec][] {
  const ends = [box.low, box.high] as const;
  const corner = (number: number): Vec =>
    inWorld(box, [0, 1, 2].map((axis) => ends[(number >> axis) & 1]?.[axis] ?? 0) as unknown as Vec);
  return [0, 1, 2].flatMap((axis) =>
    [0, 1, 2, 3, 4, 5, 6, 7]
      .filter((number) => !((number >> axis) & 1))
      .map((number): [Vec, Vec] => [corner(number), corner(number | (1 << axis))]),
  );
}

/** The same box as the service takes it. */
function placed(box: CropBox): NonNullable<GaussianFilter["box"]> {
  const [x, y, z] = inWorld(box, scale(add(box.low, box.high), 0.5));
  const [sx, sy, sz] = add(box.high, scale(box.low, -1));
  return { center: { position: { x, y, z }, orientation: quaternionOf(box.axes) }, size: { x: sx, y: sy, z: sz } };
}

/** The rotation whose columns these are. */
export function quaternionOf([first, second, third]: readonly [Vec, Vec, Vec]) {
  // Shepperd's method: by the largest of the four, which is never near 0.
  const trace = first[0] + second[1] + third[2];
  const squares = [first[0], second[1], third[2], trace].map((each) => (each === trace ? trace : 2 * each - trace));
  const [xx = 0, yy = 0, zz = 0] = squares;
  const [a, b, c] = [second[2] - third[1], third[0] - first[2], first[1] - second[0]];
  const [ab, ac, bc] = [first[1] + second[0], first[2] + third[0], second[2] + third[1]];
  const largest = Math.max(xx, yy, zz, trace);
  const [x, y, z, w] =
    largest === trace
      ? [a, b, c, 1 + trace]
      : largest === xx
        ? [1 + xx, ab, ac, a]
        : largest === yy
          ? [ab, 1 + yy, bc, b]
          : [ac, bc, 1 + zz, c];
  const norm = Math.hypot(x, y, z, w);
  return { x: x / norm, y: y / norm, z: z / norm, w: w / norm };
}
