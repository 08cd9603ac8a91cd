import { expect, test } from "vitest";
import { knownNames } from "./knownNames";

const suggestion = (name: string, probability: number) => ({
  name,
  probability,
  scene_id: "",
  aliases: [],
  said_by: [],
});

test("names that objects bear come first, then suggested ones", () => {
  const objects = [
    { name: "", suggestions: [suggestion("bench", 0.12), suggestion("dining table", 0.19)] },
    { name: "cup", suggestions: [suggestion("bowl", 0.15)] },
    { name: "cup", suggestions: [] },
    { name: "vase", suggestions: [] },
  ];
  expect(knownNames(objects)).toEqual(["cup", "vase", "dining table", "bowl", "bench"]);
  expect(knownNames([])).toEqual([]);
});
