import { expect, test } from "vitest";

import type { Motion } from "./motions";
import { isRest, matrixOf, poseOf, rowsOf, turnOf } from "./motions";

const rest: Motion = { pivot: [1, 2, 3], shift: [0, 0, 0], angles: [0, 0, 0] };

function applied(motion: Motion, point: number[]): number[] {
  const m = matrixOf(motion);
  return [0, 1, 2].map((row) =>
    [...point, 1].reduce((sum, value, column) => sum + (m[4 * column + row] ?? 0) * value, 0),
  );
}

test("no motion leaves everything where it is", () => {
  expect(isRest(rest)).toBe(true);
  expect(poseOf(rest)).toEqual({ position: { x: 0, y: 0, z: 0 }, orientation: { x: 0, y: 0, z: 0, w: 1 } });
});

test("a turn leaves its pivot in place and a shift moves it", () => {
  const turned = { ...rest, angles: [0.3, -0.4, 1.1] as const };
  applied(turned, [1, 2, 3]).forEach((value, axis) => expect(value).toBeCloseTo([1, 2, 3][axis] ?? 0, 5));
  const both = { ...turned, shift: [0.5, 0, -1] as const };
  applied(both, [1, 2, 3]).forEach((value, axis) => expect(value).toBeCloseTo([1.5, 2, 2][axis] ?? 0, 5));
});

test("a quarter turn about z takes x to y", () => {
  const quarter: Motion = { pivot: [0, 0, 0], shift: [0, 0, 0], angles: [0, 0, Math.PI / 2] };
  applied(quarter, [1, 0, 0]).forEach((value, axis) => expect(value).toBeCloseTo([0, 1, 0][axis] ?? 0, 6));
  const rows = rowsOf(turnOf({ ...quarter, angles: [0.2, 0.7, -2] }));
  const [a, b] = rows;
  expect(a[0] * b[0] + a[1] * b[1] + a[2] * b[2]).toBeCloseTo(0, 9);
});
