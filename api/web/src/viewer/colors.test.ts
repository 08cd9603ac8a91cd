import { describe, expect, test } from "vitest";

import type { SceneThing } from "../api/types";
import { coloringByLabel, coloringByThing, colorOf, NOTHING, tintsOf } from "./colors";
import { length, subtract } from "./vectors";

describe("colors", () => {
  const things = ["mug", "", "mug", "ball"].map((name, index) => ({ id: index + 1, name }) as SceneThing);

  test("differ from number to number", () => {
    const all = Array.from({ length: 24 }, (_, index) => colorOf(index + 1));
    for (const [index, color] of all.entries())
      for (const other of all.slice(index + 1)) expect(length(subtract(color, other))).toBeGreaterThan(12);
  });

  test("things of one name have one color as labels, and each its own as things", () => {
    const { byThing, legend } = coloringByLabel(things);
    expect(legend.map((entry) => entry.name)).toEqual(["ball", "mug"]);
    expect(byThing.get(1)).toEqual(byThing.get(3));
    expect(byThing.has(2)).toBe(false);
    expect(new Set(coloringByThing(things, String).byThing.values()).size).toBe(4);
  });

  test("are each Gaussian's, by row", () => {
    const tints = tintsOf(new Uint16Array([0, 2, 9]), new Map([[2, [1, 2, 3] as const]]));
    expect([...tints]).toEqual([...NOTHING, 255, 1, 2, 3, 255, ...NOTHING, 255]);
  });
});
