import { expect, test } from "vitest";
import { knownNames } from "./knownNames";

const suggestion = (name: string, probability: number) => ({
  name,
  probability,
  scene_id: "",
  aliases: [],
  said_by: [],
});

test("names that things bear come first, then suggested ones; what a person named has no other name", () => {
  const things = [
    { name: "", source: null, suggestions: [suggestion("bench", 0.12), suggestion("dining table", 0.19)] },
    { name: "cup", source: "detected" as const, suggestions: [suggestion("bowl", 0.15)] },
    { name: "cup", source: "detected" as const, suggestions: [] },
    { name: "vase", source: "person" as const, suggestions: [suggestion("jar", 0.9)] },
  ];
  expect(knownNames(things)).toEqual(["cup", "vase", "dining table", "bowl", "bench"]);
  expect(knownNames([])).toEqual([]);
});
