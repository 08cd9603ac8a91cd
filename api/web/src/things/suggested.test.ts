import { expect, test } from "vitest";

import type { SceneThing } from "../api/types";
import { filledIn, likelyNames, naming, othersSaying } from "./suggested";

const thing = (id: number, ...suggestions: [string, number, ...string[]][]): SceneThing =>
  ({
    id,
    name: "",
    suggestions: suggestions.map(([name, probability, ...aliases]) => ({
      name,
      probability,
      aliases,
      scene_id: "",
      said_by: ["detector", "eyes"].map((source) => ({ source, model: "", probability })),
    })),
  }) as SceneThing;

test("names from 80 % on are confirmed at once, each the likeliest of its thing, with its aliases", () => {
  const things = [
    thing(1, ["mug", 0.8, "cup"], ["vase", 0.1]),
    thing(2, ["mug", 0.79]),
    thing(3),
    { ...thing(4, ["mug", 0.9]), name: "jug" },
    thing(5, ["vase", 0.99]),
  ];
  expect(likelyNames(things)).toEqual([
    { action: "name", thing_ids: [1], name: "mug", aliases: ["cup"] },
    { action: "name", thing_ids: [5], name: "vase", aliases: [] },
  ]);
  const many = Array.from({ length: 150 }, (_, index) => thing(index + 1, ["mug", 0.9]));
  expect(likelyNames(many)).toHaveLength(100);
});

test("a name is filled in if it is likelier than not", () => {
  expect(filledIn(thing(1, ["mug", 0.5], ["vase", 0.4]))?.name).toBe("mug");
  expect(filledIn(thing(1, ["mug", 0.49]))).toBeNull();
  expect(filledIn(thing(1))).toBeNull();
});

test("aliases come with the name that they were suggested with", () => {
  const [both] = [thing(1, ["mug", 0.8, "cup"])];
  expect(naming(both, "mug", ["mine"]).aliases).toEqual(["cup", "mine"]);
  expect(naming(both, "vase", ["mine"]).aliases).toEqual(["mine"]);
});

test("the scene's own models are not said to say so", () => {
  const [first] = thing(1, ["mug", 0.8]).suggestions;
  expect(first && othersSaying(first)).toEqual(["eyes"]);
});
