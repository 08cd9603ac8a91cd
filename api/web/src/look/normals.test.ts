import { expect, test } from "vitest";

import { normalTints } from "./normals";

const HALF = Math.SQRT1_2;

function columns(quat: number[], scales: number[]): Map<string, Float32Array> {
  const values = { x: 0, y: 0, z: 0, rot_0: quat[0], rot_1: quat[1], rot_2: quat[2], rot_3: quat[3] };
  const sizes = { scale_0: scales[0], scale_1: scales[1], scale_2: scales[2] };
  return new Map(
    Object.entries({ ...values, ...sizes }).map(([name, value]) => [name, new Float32Array([value ?? 0])]),
  );
}

test.each([
  [
    [1, 0, 0, 0],
    [-5, -1, -1],
    [255, 128, 128],
  ],
  [
    [2, 0, 0, 0],
    [-1, -5, -1],
    [128, 255, 128],
  ],
  [
    [1, 0, 0, 0],
    [-1, -1, -5],
    [128, 128, 255],
  ],
  [
    [HALF, 0, 0, HALF],
    [-5, -1, -1],
    [128, 255, 128],
  ], // a quarter turn about z takes x to y
  [
    [HALF, HALF, 0, 0],
    [-1, -5, -1],
    [128, 128, 255],
  ], // about x, y to z
  [
    [HALF, 0, HALF, 0],
    [-1, -1, -5],
    [255, 128, 128],
  ], // about y, z to x
])("the shortest axis of %j with %j is a color, towards the cameras", (quat, scales, color) => {
  const tints = normalTints(columns(quat, scales), [3, 3, 3]);
  const near = (bytes: Uint8Array, expected: number[]) =>
    [...bytes].every((byte, i) => Math.abs(byte - (expected[i] ?? 0)) < 2);
  expect(near(tints, [...color, 255])).toBe(true);
  const away = normalTints(columns(quat, scales), [-3, -3, -3]);
  expect(near(away, [...color.map((value) => (value === 255 ? 0 : 128)), 255])).toBe(true);
});
