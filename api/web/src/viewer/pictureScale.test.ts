import { expect, test } from "vitest";

import { nextScale, pictureSize } from "./pictureScale";

const MOST = 110;

test("pictures get smaller until they come quickly, and no smaller than a quarter", () => {
  expect(nextScale(1, 300, MOST)).toBeCloseTo(Math.SQRT1_2);
  expect(nextScale(0.5, 300, MOST)).toBeCloseTo(Math.SQRT1_2 / 2);
  expect(nextScale(0.25, 300, MOST)).toBe(0.25);
});

test("pictures get larger only where the larger ones come quickly too", () => {
  for (let milliseconds = 1; milliseconds < 400; milliseconds++)
    for (const scale of [0.25, 0.5, 0.7]) {
      const larger = nextScale(scale, milliseconds, MOST);
      if (larger > scale) expect(nextScale(larger, 2 * milliseconds, MOST)).toBeGreaterThanOrEqual(larger);
    }
  expect(nextScale(0.9, 20, MOST)).toBe(1);
  expect(nextScale(1, 20, MOST)).toBe(1);
});

test("a picture has the shape of its place, and not more pixels than allowed", () => {
  expect(pictureSize(640, 480, 1, 1_000_000)).toEqual([640, 480]);
  expect(pictureSize(640, 480, 0.5, 1_000_000)).toEqual([320, 240]);
  const [width, height] = pictureSize(4_000, 2_000, 1, 1_000_000);
  expect(width * height).toBeLessThan(1_001_000);
  expect(width / height).toBeCloseTo(2, 2);
  expect(pictureSize(3, 1, 0.25, 100)).toEqual([1, 1]);
});
