import { describe, expect, test } from "vitest";

import { DepthRange } from "./depthRange";
import { draftOf, ofRows, thinner } from "./draft";
import { fewerBands } from "./harmonics";
import { random } from "./random.fixture";
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

describe("a draft", () => {
  const count = 4_000;
  const next = random(3);
  const opacities = Array.from({ length: count }, () => 0.02 + 0.9 * next() ** 3);
  const sizes = Array.from({ length: count }, (_, row) => Math.exp(3 * next() - (row % 40 ? 6 : 0)));
  const made = splat(count, 3);
  const given = new Map([
    ...made.columns,
    ["opacity", Float32Array.from(opacities, (value) => Math.log(value / (1 - value)))],
    ...["scale_0", "scale_1", "scale_2"].map((name) => [name, Float32Array.from(sizes, Math.log)] as const),
  ]);
  const draft = draftOf({ count, columns: given }, 500);
  const rows = [...(draft?.rows ?? [])];
  const alpha = (columns: ReadonlyMap<string, Float32Array>, at: number) =>
    1 / (1 + Math.exp(-(columns.get("opacity")?.[at] ?? 0)));
  const cover = (columns: ReadonlyMap<string, Float32Array>, at: number) =>
    alpha(columns, at) * Math.exp(2 * (columns.get("scale_1")?.[at] ?? 0));
  const own: ReadonlyMap<string, Float32Array> = draft?.splat.columns ?? new Map();

  test("has about so many Gaussians, each once, without harmonics", () => {
    expect(rows.length).toBeGreaterThan(450);
    expect(rows.length).toBeLessThan(550);
    expect(rows).toEqual([...new Set(rows)].sort((one, other) => one - other));
    expect([...own.keys()].filter((name) => name.startsWith("f_rest"))).toEqual([]);
    expect([...(own.get("f_dc_0") ?? [])]).toEqual(rows.map((row) => given.get("f_dc_0")?.[row]));
    expect(draft?.splat.count).toBe(rows.length);
  });

  test("covers what the splat does, and no Gaussian less than its own", () => {
    const sum = (columns: ReadonlyMap<string, Float32Array>, all: readonly number[]) =>
      all.reduce((total, at) => total + cover(columns, at), 0);
    const every = Array.from({ length: count }, (_, row) => row);
    const ratio = sum(own, [...rows.keys()]) / sum(given, every);
    expect(ratio).toBeGreaterThan(0.95);
    expect(ratio).toBeLessThan(1.05);
    rows.forEach((row, at) => expect(cover(own, at)).toBeGreaterThan(0.999 * cover(given, row)));
    rows.forEach((_, at) => expect(alpha(own, at)).toBeLessThan(0.995));
  });

  test("keeps those that cover most as they are", () => {
    const covers = Array.from({ length: count }, (_, row) => cover(given, row));
    const most = covers.map((_, row) => row).sort((one, other) => (covers[other] ?? 0) - (covers[one] ?? 0));
    for (const row of most.slice(0, 50)) {
      const at = rows.indexOf(row);
      expect(at).toBeGreaterThanOrEqual(0);
      for (const [name, data] of own) expect(data[at]).toBe(given.get(name)?.[row]);
    }
  });

  test("is not made of a small splat", () => expect(draftOf(splat(140), 100)).toBeNull());
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

test("a thinner draft is of the first one's Gaussians, and never too thin", () => {
  const made = splat(40_000, 0);
  const level = new Float32Array(made.count).fill(-3);
  const alike = ["opacity", "scale_0", "scale_1", "scale_2"].map((name) => [name, level] as const);
  const given = { count: made.count, columns: new Map([...made.columns, ...alike]) };
  const first = draftOf(given);
  if (!first) throw new Error("so many need a draft");
  const second = thinner(first, 0.5);
  expect(Math.abs((second?.splat.count ?? 0) / first.splat.count - 0.5)).toBeLessThan(0.1);
  expect([...(second?.rows ?? [])].every((row) => first.rows.includes(row))).toBe(true);
  const places = [...(second?.rows ?? [])].map((row) => given.columns.get("x")?.[row]);
  expect([...(second?.splat.columns.get("x") ?? [])]).toEqual(places);
  expect(thinner(first, 1e-3)?.splat.count).toBeGreaterThan(5_000);
  expect(thinner(first, 0.9)).toBeNull();
});
