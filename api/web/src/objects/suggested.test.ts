import { expect, test } from "vitest";

import type { SceneObject } from "../api/types";
import { filledIn, likelyNames, naming, othersSaying } from "./suggested";

const object = (id: number, ...suggestions: [string, number, ...string[]][]): SceneObject =>
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
  }) as SceneObject;

test("names from 80 % on are confirmed at once, each the likeliest of its object, with its aliases", () => {
  const objects = [
    object(1, ["mug", 0.8, "cup"], ["vase", 0.1]),
    object(2, ["mug", 0.79]),
    object(3),
    { ...object(4, ["mug", 0.9]), name: "jug" },
    object(5, ["vase", 0.99]),
  ];
  expect(likelyNames(objects)).toEqual([
    { action: "name", object_ids: [1], name: "mug", aliases: ["cup"] },
    { action: "name", object_ids: [5], name: "vase", aliases: [] },
  ]);
  const many = Array.from({ length: 150 }, (_, index) => object(index + 1, ["mug", 0.9]));
  expect(likelyNames(many)).toHaveLength(100);
});

test("a name is filled in if it is likelier than not", () => {
  expect(filledIn(object(1, ["mug", 0.5], ["vase", 0.4]))?.name).toBe("mug");
  expect(filledIn(object(1, ["mug", 0.49]))).toBeNull();
  expect(filledIn(object(1))).toBeNull();
});

test("aliases come with the name that they were suggested with", () => {
  const [both] = [object(1, ["mug", 0.8, "cup"])];
  expect(naming(both, "mug", ["mine"]).aliases).toEqual(["cup", "mine"]);
  expect(naming(both, "vase", ["mine"]).aliases).toEqual(["mine"]);
});

test("the scene's own models are not said to say so", () => {
  const [first] = object(1, ["mug", 0.8]).suggestions;
  expect(first && othersSaying(first)).toEqual(["eyes"]);
});
