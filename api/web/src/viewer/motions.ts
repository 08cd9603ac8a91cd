import type { Edit } from "../api/types";
import type { Vec } from "./vectors";
import { add, subtract } from "./vectors";

/** A rigid motion: turned around `pivot` by `angles` (radians, about x, then y, then z of the world), then shifted. */
export interface Motion {
  pivot: Vec;
  shift: Vec;
  angles: Vec;
}

interface Quaternion {
  x: number;
  y: number;
  z: number;
  w: number;
}

export function isRest({ shift, angles }: Motion): boolean {
  return [...shift, ...angles].every((value) => value === 0);
}

/** The rotation of a motion as a unit quaternion. */
export function turnOf({ angles }: Motion): Quaternion {
  const [x, y, z] = angles.map((angle, axis) => {
    const [sine, cosine] = [Math.sin(angle / 2), Math.cos(angle / 2)];
    return { x: axis === 0 ? sine : 0, y: axis === 1 ? sine : 0, z: axis === 2 ? sine : 0, w: cosine };
  }) as [Quaternion, Quaternion, Quaternion];
  return multiplied(z, multiplied(y, x));
}

function multiplied(a: Quaternion, b: Quaternion): Quaternion {
  return {
    x: a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
    y: a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
    z: a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
    w: a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
  };
}

/** The rows of the rotation matrix of a unit quaternion. */
export function rowsOf({ x, y, z, w }: Quaternion): [Vec, Vec, Vec] {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
    [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
    [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
  ];
}

/** The motion as x' = R x + t: what `move` and `duplicate` take. */
export function poseOf(motion: Motion): NonNullable<Edit["transform"]> {
  const turn = turnOf(motion);
  const turned = rowsOf(turn).map(
    (row) => row[0] * motion.pivot[0] + row[1] * motion.pivot[1] + row[2] * motion.pivot[2],
  );
  const [x, y, z] = subtract(add(motion.pivot, motion.shift), turned as unknown as Vec);
  return { position: { x, y, z }, orientation: turn };
}

/** The same as sixteen numbers, column by column. */
export function matrixOf(motion: Motion): Float32Array {
  const { position } = poseOf(motion);
  const [a, b, c] = rowsOf(turnOf(motion));
  return new Float32Array([
    ...[a[0], b[0], c[0], 0],
    ...[a[1], b[1], c[1], 0],
    ...[a[2], b[2], c[2], 0],
    ...[position.x, position.y, position.z, 1],
  ]);
}

/** A vector with one of its numbers replaced. */
export function withAxis(vector: Vec, axis: number, value: number): Vec {
  return vector.map((old, each) => (each === axis ? value : old)) as unknown as Vec;
}
