import { expect, test } from "vitest";

import type { PosedCamera } from "../api/types";
import type { LookAt } from "./poses";
import { cameraOf } from "./poses";
import { Projection } from "./projection";
import type { Vec } from "./vectors";
import { length, subtract, unit } from "./vectors";
import { viewOfSight } from "./viewpoints";

const SIZE = { width: 800, height: 600 };
const at = (position: Vec, name: string): PosedCamera => ({
  ...cameraOf({ position, target: [0, 0, 0], up: [0, 0, 1] }, 640, 480),
  name,
});
const cameras = [at([3, 0, 1], "a"), at([0, 3, 1], "b"), at([-3, 0, 1], "c")];
const now: LookAt = { position: [1, -3, 1], target: [0, 0, 0], up: [0, 0, 1] };
const direction = (view: LookAt) => unit(subtract(view.position, view.target));

test("an object is looked at from the photo that shows it best, at a third of the height", () => {
  const view = viewOfSight({ middle: [0, 0, 0], size: 0.6, views: ["b", "a"] }, cameras, now, SIZE);
  expect(length(subtract(direction(view), unit([0, 3, 1])))).toBeLessThan(1e-9);
  const projection = new Projection(view, SIZE);
  const [top, bottom] = [projection.point([0, 0, 0.3]), projection.point([0, 0, -0.3])];
  const share = ((bottom?.[1] ?? 0) - (top?.[1] ?? 0)) / SIZE.height;
  expect(share).toBeGreaterThan(0.27);
  expect(share).toBeLessThan(0.34);
});

test.each([0.001, 0.1, 5, 80])(
  "of an object of size %f the camera stays between half a photo's distance and it",
  (size) => {
    const view = viewOfSight({ middle: [0.2, 0, 0], size }, cameras, now, SIZE);
    const photo = length(subtract([3, 0, 1], [0.2, 0, 0]));
    const distance = length(subtract(view.position, view.target));
    expect(distance).toBeGreaterThan(0.49 * photo);
    expect(distance).toBeLessThan(1.11 * photo);
  },
);

test("without a camera the direction stays", () => {
  const view = viewOfSight({ middle: [1, 1, 1], size: 0.2 }, [], now, SIZE);
  expect(length(subtract(direction(view), direction({ ...now, target: [1, 1, 1] })))).toBeLessThan(1e-9);
});

test.each([
  { width: 460, height: 1050 },
  { width: 390, height: 380 },
  { width: 1000, height: 600 },
])("an object is shown whole in a picture of $width x $height, though the head turns to what was seen", (size) => {
  const sight = { middle: [0.5, 0.8, 0] as Vec, size: 0.7, views: ["a"] };
  for (const shown of [() => true, ({ target }: LookAt) => length(subtract(target, sight.middle)) > 0.3]) {
    const projection = new Projection(viewOfSight(sight, cameras, now, size, shown), size);
    for (const axis of [0, 1, 2])
      for (const side of [-1, 1]) {
        const end = sight.middle.map((value, each) => value + (each === axis ? (side * sight.size) / 2 : 0)) as never;
        const [x, y] = projection.point(end) ?? [-1, -1];
        expect(Math.min(x, size.width - x, y, size.height - y)).toBeGreaterThanOrEqual(0);
      }
  }
});
