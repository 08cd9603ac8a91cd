import { expect, test } from "vitest";

import type { SceneThing } from "../api/types";
import { lookAlikes } from "./lookAlikeList";

const thing = (id: number, name: string, ...suggestions: [string, number, string?][]): SceneThing =>
  ({
    id,
    name,
    suggestions: suggestions.map(([text, probability, scene_id = ""]) => ({
      name: text,
      probability,
      scene_id,
      aliases: [] as string[],
      said_by: [] as SceneThing["suggestions"][number]["said_by"],
    })),
  }) as SceneThing;

test("those without a name for which the name is likely come likeliest first", () => {
  const things = [
    thing(1, "mug", ["mug", 0.9]),
    thing(2, "", ["mug", 0.8]),
    thing(3, "", ["mug", 0.95]),
    thing(6, "", ["mug", 0.79]),
    thing(4, "", ["cup", 0.8]),
    thing(5, "", ["mug", 0.9, "another scene"]),
    thing(6, "", ["mug", 0.1]),
  ];
  expect(lookAlikes(things, "mug").map((each) => each.id)).toEqual([3, 2]);
  expect(lookAlikes(things, "mug", new Set([3])).map((each) => each.id)).toEqual([2]);
  expect(lookAlikes(things, "")).toEqual([]);
});
