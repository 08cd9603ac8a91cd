import { gzipSync } from "node:zlib";

import { expect, test } from "vitest";

import { nameOf, plain, unzipped } from "./data";

const NAMES = [
  { name: "Coffee-Machines", key: "coffee machine", answer: 0 },
  { name: "mug", key: "mug", answer: 1 },
  { name: "glass", key: "glass", answer: 2 },
  { name: "the object", key: "the object", answer: 3 },
];

test.each([
  ["mug", 1],
  ["Where is the MUG?", 1],
  ["show me my mugs", 1],
  ["coffee machine", 0],
  ["coffee machines", 0],
  ["glasses", 2],
  ["the object", 3],
])("%j is asked for", (text, answer) => expect(nameOf(text, NAMES)?.answer).toBe(answer));

test.each(["", "?!", "muggle", "red mug", "not the mug"])("%j is not among the names", (text) =>
  expect(nameOf(text, NAMES)).toBeNull(),
);

test("question words alone are a name", () => expect(plain("where")).toBe("where"));

test("packed bytes come back", async () => {
  expect([...(await unzipped(new Uint8Array(gzipSync(new Uint8Array([1, 2, 3])))))]).toEqual([1, 2, 3]);
});
