import { expect, test } from "vitest";

import type { StageProgress } from "../api/types";
import { duration, secondsLeft } from "./timing";

const stage = (fraction: number, seconds: number): StageProgress => ({
  stage: "training",
  fraction,
  seconds,
  message: "",
  metrics: {},
});

test("a stage ends at its rate so far", () => {
  expect(secondsLeft(stage(0.25, 30))).toBe(90);
  expect(secondsLeft(stage(0, 30))).toBeNull();
  expect(secondsLeft(stage(1, 30))).toBeNull();
});

test.each([
  [12.4, "12 s"],
  [89, "89 s"],
  [150, "3 min"],
])("%d seconds are %s", (seconds, text) => expect(duration(seconds)).toBe(text));
