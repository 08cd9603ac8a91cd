import { expect, test } from "vitest";

import { nextLevel } from "./levels";

const at = (...levels: ("part" | "object" | "group")[]) =>
  levels.map((level, number) => ({ level, id: number + 1, members: [], probability: 1 / levels.length }));

test("a second click takes the next level, and after the last the first", () => {
  const levels = at("part", "object", "group");
  expect(nextLevel({ levels, level: "part" })).toBe("object");
  expect(nextLevel({ levels, level: "object" })).toBe("group");
  expect(nextLevel({ levels, level: "group" })).toBe("part");
});

test("levels that are not there are left out", () => {
  expect(nextLevel({ levels: at("object", "group"), level: "group" })).toBe("object");
  expect(nextLevel({ levels: at("object"), level: "object" })).toBe("object");
});
