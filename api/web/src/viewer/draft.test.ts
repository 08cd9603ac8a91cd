import { expect, test } from "vitest";

import { DepthRange } from "./depthRange";
import { draftOf, ofRows } from "./draft";
import { fewerBands } from "./harmonics";
import type { SplatColumns } from "./spz";

function splat(count: number, rest = 45): SplatColumns {
  const names = [
    "x",
    "y",
    "z",
    "opacity",
    "f_dc_0",
    "scale_0",
    ...Array.from({ length: rest }, (_, n) => `f_rest_${n}`),
  ];
  return {
    count,
    columns: new Map(
      names.map((name, index) => [name, Float32Array.from({ length: count }, (_, row) => row + index / 100)]),
    ),
  };
}

test("a draft is every so many-th Gaussian, as much larger, without harmonics", () => {
  const draft = draftOf(splat(1_000), 100);
  expect(draft?.splat.count).toBe(100);
  expect([...(draft?.rows ?? [])]).toEqual(Array.from({ length: 100 }, (_, index) => index * 10));
  expect([...(draft?.splat.columns.keys() ?? [])]).toEqual(["x", "y", "z", "opacity", "f_dc_0", "scale_0"]);
  expect(draft?.splat.columns.get("y")?.[7]).toBeCloseTo(70.01, 4);
  expect(Math.exp(2 * ((draft?.splat.columns.get("scale_0")?.[0] ?? 0) - 0.05))).toBeCloseTo(10, 3);
  expect(draftOf(splat(150), 100)).toBeNull();
});

test("what belongs to a draft's rows is picked", () => {
  expect([...ofRows(new Uint8Array([1, 2, 3, 4]), new Uint32Array([0, 3]))]).toEqual([1, 4]);
  expect([...ofRows(new Uint8Array([1, 2, 3, 4]), new Uint32Array([1]), 2)]).toEqual([3, 4]);
});

test("of a large splat one band of harmonics stays, each channel's own", () => {
  const reduced = fewerBands(splat(10), 5);
  const first = (name: string) => reduced.columns.get(name)?.[0];
  expect([...reduced.columns.keys()].filter((name) => name.startsWith("f_rest"))).toHaveLength(9);
  // Channels follow each other, 15 harmonics each: the second begins at f_rest_15, here 6 columns later.
  expect(["f_rest_0", "f_rest_2", "f_rest_3", "f_rest_6"].map(first)).toEqual(
    [6, 8, 21, 36].map((column) => Math.fround(column / 100)),
  );
  expect(fewerBands(splat(10), 10).columns.size).toBe(51);
  expect(fewerBands(splat(10, 9), 5).columns.size).toBe(15);
});

test("depths are those of the Gaussians in view, without outliers", () => {
  const count = 1_000;
  const columns = new Map([
    ["x", new Float32Array(count)],
    ["y", Float32Array.from({ length: count }, (_, row) => (row === 0 ? 1e6 : row < 500 ? -5 : 2 + row / 1_000))],
    ["z", new Float32Array(count)],
    ["opacity", new Float32Array(count)],
  ]);
  const [near, far] = new DepthRange(columns).of({ position: [0, 0, 0], target: [0, 1, 0], up: [0, 0, 1] });
  expect(near).toBeGreaterThan(2.49);
  expect(far).toBeLessThan(3);
  expect(far).toBeGreaterThan(near);
});
