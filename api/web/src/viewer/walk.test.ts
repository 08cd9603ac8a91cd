import { expect, test } from "vitest";

import type { Direction } from "./walk";
import { nearestTo, nextIn } from "./walk";

const places = new Map<number, [number, number]>([
  [1, [0, 0]],
  [2, [10, 1]],
  [3, [30, 0]],
  [4, [9, 40]],
  [5, [-20, -5]],
]);

test.each<[Direction, number, number | null]>([
  ["ArrowRight", 1, 2],
  ["ArrowRight", 2, 3],
  ["ArrowRight", 3, null],
  ["ArrowLeft", 1, 5],
  ["ArrowDown", 2, 4],
  ["ArrowUp", 4, 2],
])("%s of %d is %s", (direction, from, to) => expect(nextIn(direction, from, places)).toBe(to));

test("every place is reached by walking", () => {
  const reached = new Set([nearestTo([1, 1], places)]);
  for (let round = 0; round < places.size; round++)
    for (const from of [...reached])
      for (const way of ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown"] as const) {
        const next = from === null ? null : nextIn(way, from, places);
        if (next !== null) reached.add(next);
      }
  expect([...reached].sort()).toEqual([1, 2, 3, 4, 5]);
  expect(nearestTo([0, 0], new Map())).toBeNull();
});
