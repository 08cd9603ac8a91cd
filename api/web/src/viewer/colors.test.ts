import { describe, expect, test } from "vitest";

import type { SceneObject } from "../api/types";
import { coloringByLabel, coloringByObject, colorOf, NOTHING, tintsOf } from "./colors";
import { length, subtract } from "./vectors";

describe("colors", () => {
  const objects = ["mug", "", "mug", "ball"].map((name, index) => ({ id: index + 1, name }) as SceneObject);

  test("differ from number to number", () => {
    const all = Array.from({ length: 24 }, (_, index) => colorOf(index + 1));
    for (const [index, color] of all.entries())
      for (const other of all.slice(index + 1)) expect(length(subtract(color, other))).toBeGreaterThan(12);
  });

  test("objects of one name have one color as labels, and each its own as objects", () => {
    const { byObject, legend } = coloringByLabel(objects);
    expect(legend.map((entry) => entry.name)).toEqual(["ball", "mug"]);
    expect(byObject.get(1)).toEqual(byObject.get(3));
    expect(byObject.has(2)).toBe(false);
    expect(new Set(coloringByObject(objects, String).byObject.values()).size).toBe(4);
  });

  test("are each Gaussian's, by row", () => {
    const tints = tintsOf(new Uint16Array([0, 2, 9]), new Map([[2, [1, 2, 3] as const]]));
    expect([...tints]).toEqual([...NOTHING, 255, 1, 2, 3, 255, ...NOTHING, 255]);
  });
});
