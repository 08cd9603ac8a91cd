import { expect, test } from "vitest";

import type { SceneObject } from "../api/types";
import { lookAlikes } from "./lookAlikeList";

const object = (id: number, name: string, ...suggestions: [string, number, string?][]): SceneObject =>
  ({
    id,
    name,
    suggestions: suggestions.map(([text, probability, scene_id = ""]) => ({
      name: text,
      probability,
      scene_id,
      aliases: [] as string[],
      said_by: [] as SceneObject["suggestions"][number]["said_by"],
    })),
  }) as SceneObject;

test("those without a name for which the name is likely come likeliest first", () => {
  const objects = [
    object(1, "mug", ["mug", 0.9]),
    object(2, "", ["mug", 0.8]),
    object(3, "", ["mug", 0.95]),
    object(6, "", ["mug", 0.79]),
    object(4, "", ["cup", 0.8]),
    object(5, "", ["mug", 0.9, "another scene"]),
    object(6, "", ["mug", 0.1]),
  ];
  expect(lookAlikes(objects, "mug").map((each) => each.id)).toEqual([3, 2]);
  expect(lookAlikes(objects, "mug", new Set([3])).map((each) => each.id)).toEqual([2]);
  expect(lookAlikes(objects, "")).toEqual([]);
});
