import { expect, test } from "vitest";

import { wordsOf } from "./words";

test("words are separated by commas, trimmed, and each is there once", () => {
  expect(wordsOf(" teddy bear,toy, ,toy ")).toEqual(["teddy bear", "toy"]);
  expect(wordsOf(" , ")).toEqual([]);
});
