import { expect, test } from "vitest";

import type { StageProgress } from "../api/types";
import { duration, jobCountdown, secondsLeft, stageCountdown } from "./timing";

const stage = (fraction: number, seconds: number): StageProgress => ({
  stage: "training",
  fraction,
  seconds,
  message: "",
  metrics: {},
});

const leftOf = (fraction: number, seconds: number) => secondsLeft(stageCountdown(null, stage(fraction, seconds), 0), 0);

test("a stage ends at its rate so far", () => {
  expect(leftOf(0.25, 30)).toBe(90);
  expect(leftOf(0, 30)).toBeNull();
  expect(leftOf(1, 30)).toBeNull();
});

test("while nothing comes, the time left counts down and is withdrawn", () => {
  let countdown = stageCountdown(null, stage(0.5, 10), 100);
  const seen: (number | null)[] = [];
  for (let now = 100; now < 130; now += 4) {
    countdown = stageCountdown(countdown, stage(0.5, 10), now); // the same, once more
    seen.push(secondsLeft(countdown, now));
  }
  expect(seen).toEqual([10, 6, 2, null, null, null, null, null]);
  expect(secondsLeft(stageCountdown(countdown, stage(0.8, 40), 130), 131)).toBeCloseTo(9);
  const job = jobCountdown(null, 30, 0);
  expect(secondsLeft(jobCountdown(job, 30, 20), 20)).toBe(10);
  expect(secondsLeft(jobCountdown(job, 50, 20), 20)).toBe(50);
  expect(secondsLeft(jobCountdown(job, null, 20), 20)).toBeNull();
});

test.each([
  [12.4, "12 s"],
  [89, "89 s"],
  [150, "3 min"],
])("%d seconds are %s", (seconds, text) => expect(duration(seconds)).toBe(text));
