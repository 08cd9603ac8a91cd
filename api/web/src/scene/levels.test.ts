import { expect, test } from "vitest";

import { nextLevel } from "./levels";

const at = (...levels: ("part" | "thing" | "group")[]) =>
  levels.map((level, number) => ({ level, id: number + 1, members: [], probability: 1 / levels.length }));

test("a second click takes the next level, and after the last the first", () => {
  const levels = at("part", "thing", "group");
  expect(nextLevel({ levels, level: "part" })).toBe("thing");
  expect(nextLevel({ levels, level: "thing" })).toBe("group");
  expect(nextLevel({ levels, level: "group" })).toBe("part");
});

test("levels that are not there are left out", () => {
  expect(nextLevel({ levels: at("thing", "group"), level: "group" })).toBe("thing");
  expect(nextLevel({ levels: at("thing"), level: "thing" })).toBe("thing");
});
