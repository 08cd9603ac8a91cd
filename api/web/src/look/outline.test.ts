import { describe, expect, test } from "vitest";

import { decodeRle, outlinePixels } from "./outline";

describe("a mask's outline", () => {
  // What the service sends of a 4 × 5 picture (height × width) whose pixels (1..2, 1..3) are set.
  const segmentation = { size: [4, 5], counts: "5220003" };

  test("run lengths down the columns are pixels", () => {
    const { width, height, mask } = decodeRle(segmentation);
    expect([width, height]).toEqual([5, 4]);
    expect([...mask]).toEqual([0, 0, 0, 0, 0, 0, 1, 1, 1, 0, 0, 1, 1, 1, 0, 0, 0, 0, 0, 0]);
    expect(() => decodeRle({ ...segmentation, size: [4, 4] })).toThrow();
  });

  test("the edge is solid, the inside a veil, the rest clear", () => {
    const mask = new Uint8Array(81).fill(1);
    const pixels = outlinePixels({ width: 9, height: 9, mask }, [9, 8, 7]);
    expect([...pixels.slice(0, 4)]).toEqual([9, 8, 7, 255]);
    expect([...pixels.slice(40 * 4, 41 * 4)]).toEqual([9, 8, 7, 40]);
    expect(outlinePixels({ width: 1, height: 1, mask: new Uint8Array(1) }, [9, 8, 7])[3]).toBe(0);
  });
});
