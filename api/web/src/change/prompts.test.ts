import { expect, test } from "vitest";

import type { SeenPlace } from "../state/changeState";
import { cameraOf } from "../viewer/poses";
import { promptOf } from "./prompts";

const here = cameraOf({ position: [0, -3, 1], target: [0, 0, 0], up: [0, 0, 1] }, 64, 48);
const there = cameraOf({ position: [1, -3, 1], target: [0, 0, 0], up: [0, 0, 1] }, 64, 48);
const place = (camera: SeenPlace["camera"], x: number): SeenPlace => ({ camera, pixel: { x, y: 1 } });

test("clicks from one viewpoint count together, those from another alone", () => {
  expect(promptOf([])).toBeNull();
  expect(promptOf([place(here, 1), place(here, 2)])?.pixels).toEqual([
    { x: 1, y: 1 },
    { x: 2, y: 1 },
  ]);
  const turned = promptOf([place(here, 1), place(there, 2)]);
  expect(turned?.pixels).toEqual([{ x: 2, y: 1 }]);
  expect(turned?.camera).toEqual(there);
});
