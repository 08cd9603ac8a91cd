import { expect, test } from "vitest";

import type { SceneSummary } from "../api/types";
import { arranged, namesIn } from "./arranged";

const scene = (name: string, day: number, gaussians: number) =>
  ({ name, created_at: `2026-01-0${day}T00:00:00Z`, gaussians }) as SceneSummary;
const scenes = [scene("Kitchen 10", 1, 5), scene("kitchen 9", 3, 1), scene("Garden", 2, 9)];
const names = (text: string, order: Parameters<typeof arranged>[2]) =>
  arranged(scenes, text, order).map((each) => each.name);

test("scenes are sorted", () => {
  expect(names("", "newest")).toEqual(["kitchen 9", "Garden", "Kitchen 10"]);
  expect(names("", "name")).toEqual(["Garden", "kitchen 9", "Kitchen 10"]);
  expect(names("", "largest")).toEqual(["Garden", "Kitchen 10", "kitchen 9"]);
});

test("a scene is found by words of its name", () => {
  expect(names(" 10 KIT", "name")).toEqual(["Kitchen 10"]);
  expect(names("sofa", "name")).toEqual([]);
});

test("of a scene those names are told that something bears, the largest first", () => {
  const entry = (label: string, gaussian_count: number) => ({ label, gaussian_count });
  expect(namesIn([entry("cup", 20), entry("tulip", 0), entry("table", 400)])).toEqual(["table", "cup"]);
});
