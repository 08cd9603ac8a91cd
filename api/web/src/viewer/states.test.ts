import { expect, test } from "vitest";

import { FOUND, fromBase64, HOVERED, PLAIN, SELECTED, statesOf, unpackBits } from "./states";

test("packed bits begin with the most significant one", () => {
  expect([...unpackBits(fromBase64("oYA="), 9)]).toEqual([1, 0, 1, 0, 0, 0, 0, 1, 1]);
});

test("selected wins over hovered, and hovered over found", () => {
  const found = new Uint8Array([1, 1, 1, 1, 0]);
  const objects = new Uint16Array([1, 2, 3, 0, 0]);
  expect([...statesOf(5, found, objects, 2, [1])]).toEqual([SELECTED, HOVERED, FOUND, FOUND, PLAIN]);
  expect([...statesOf(5, found, objects, 1, [1])]).toEqual([SELECTED, FOUND, FOUND, FOUND, PLAIN]);
});

test("of a part that is selected its own Gaussians are", () => {
  const objects = new Uint16Array([1, 1, 2, 0]);
  const part = new Uint8Array([0, 1, 0, 0]);
  expect([...statesOf(4, null, objects, 1, [7], undefined, part)]).toEqual([HOVERED, SELECTED, PLAIN, PLAIN]);
});

test("nothing is colored while nothing is known", () => {
  expect([...statesOf(3, null, null, 4, [1])]).toEqual([PLAIN, PLAIN, PLAIN]);
});
