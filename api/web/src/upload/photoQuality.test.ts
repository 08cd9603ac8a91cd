import { expect, test } from "vitest";

import type { PhotoQuality } from "./photoQuality";
import { judged, measured } from "./photoQuality";

const SIDE = 64;

/** A picture of stripes, by the gray value of each pixel. */
const picture = (gray: (x: number, y: number) => number): PhotoQuality => {
  const pixels = new Uint8ClampedArray(4 * SIDE * SIDE);
  for (let at = 0; at < SIDE * SIDE; at++) pixels.fill(gray(at % SIDE, Math.floor(at / SIDE)), 4 * at, 4 * at + 3);
  return measured(pixels, SIDE, SIDE);
};
const stripes = (phase: number, period = 4) => picture((x, y) => (((x + phase * y) / period) % 2 < 1 ? 230 : 30));
/** The same stripes with soft edges and as much contrast. */
const soft = (phase: number) => picture((x, y) => 130 + 100 * Math.sin((2 * Math.PI * (x + phase * y)) / 32));

const named = (photos: readonly PhotoQuality[]) => new Map(photos.map((photo, at) => [`${at}`, photo]));
const defects = (photos: readonly PhotoQuality[]) => [...judged(named(photos))].sort().map(([, found]) => found);

test("a soft photo among sharp ones is blurred, and soft ones alone are not", () => {
  const sharp = [stripes(1, 3), stripes(2, 5), stripes(3, 7)];
  expect(defects([...sharp, soft(1)])).toEqual([[], [], [], ["blurred"]]);
  expect(defects([soft(1), soft(-1), soft(1.2)])).toEqual([[], [], []]);
  expect(defects([stripes(1), soft(1)]).flat()).not.toContain("blurred"); // two say nothing of each other
});

test("of photos that show the same the sharpest stays", () => {
  const blurrier = picture((x) => (x < 32 ? 40 : 200) + (x % 2) * 2);
  const sharper = picture((x) => (x < 32 ? 40 : 200) + (x % 2) * 6);
  expect(defects([blurrier, sharper])).toEqual([["duplicate"], []]);
  expect(defects([picture((x) => 3 * x), picture((_, y) => 3 * y)]).flat()).toEqual([]);
});

test("a nearly black photo is dark", () => {
  expect(defects([picture((x) => x / 4)])).toEqual([["dark"]]);
});

test("nothing is said of no photos", () => {
  expect(defects([])).toEqual([]);
});
