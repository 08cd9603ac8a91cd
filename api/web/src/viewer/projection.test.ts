import { describe, expect, test } from "vitest";

import type { PosedCamera } from "../api/types";
import { axesOf, cameraOf, orbit, rayOf } from "./poses";
import { frustumOf, photoRect, Projection, viewOfPhoto } from "./projection";
import type { Vec } from "./vectors";
import { cross, dot, length, scale, subtract, unit } from "./vectors";

const SIZE = { width: 700, height: 500 };

/** A phone's camera that was held askew, its principal point off the middle, its pixels not square. */
function askew(): PosedCamera {
  const looking = cameraOf({ position: [1, -3, 1.5], target: [0.2, 0.1, 0.3], up: unit([0.3, 0.1, 1]) }, 640, 480);
  return { ...looking, name: "a", intrinsics: { width: 640, height: 480, fx: 520, fy: 500, cx: 300, cy: 260 } };
}

function pixelIn(camera: PosedCamera, point: Vec): readonly [number, number] {
  const { position, forward, up } = rayOf(camera);
  const offset = subtract(point, position);
  const { fx, fy, cx, cy } = camera.intrinsics;
  const depth = dot(offset, forward);
  return [cx + (fx * dot(offset, cross(forward, up))) / depth, cy - (fy * dot(offset, up)) / depth];
}

describe("standing at a photo", () => {
  test.each([SIZE, { width: 390, height: 500 }, { width: 1200, height: 300 }])(
    "photo and scene show each point at the same place in %o",
    (size) => {
      const camera = askew();
      const view = viewOfPhoto(camera, 3, [0, 0, 1], size);
      const rect = photoRect(camera, view, size);
      const projection = new Projection(view, size);
      for (const point of [
        [0, 0, 0],
        [0.5, 0.4, 0.2],
        [-0.6, 0.1, 0.9],
      ] as const) {
        const [u, v] = pixelIn(camera, point);
        const [x, y] = projection.point(point) ?? [NaN, NaN];
        expect(rect.left + (u / 640) * rect.width).toBeCloseTo(x, 6);
        expect(rect.top + (v / 480) * rect.height).toBeCloseTo(y, 6);
      }
    },
  );

  test("the whole photo is in the picture, and touches its edge", () => {
    for (const size of [SIZE, { width: 390, height: 500 }]) {
      const rect = photoRect(askew(), viewOfPhoto(askew(), 3, [0, 0, 1], size), size);
      const room = [rect.left, rect.top, size.width - rect.left - rect.width, size.height - rect.top - rect.height];
      expect(Math.min(...room)).toBeCloseTo(0, 6);
    }
  });

  test("the view keeps the photo's tilt, and the scene is level again once it is orbited", () => {
    const view = viewOfPhoto(askew(), 3, [0, 0, 1], SIZE);
    const { up } = rayOf(askew());
    expect(length(subtract(scale(axesOf(view).down, -1), up))).toBeLessThan(1e-9);
    expect(orbit(view, 0.1, 0).up).toEqual([0, 0, 1]);
  });
});

test("a camera is drawn from its position to the corners of its picture", () => {
  const { apex, corners } = frustumOf(askew(), 0.5);
  expect(apex).toEqual([1, -3, 1.5]);
  const pixels = corners.map((corner) => pixelIn(askew(), corner));
  const expected = [
    [0, 0],
    [640, 0],
    [640, 480],
    [0, 480],
  ];
  pixels.forEach(([u, v], index) => {
    expect(u).toBeCloseTo(expected[index]?.[0] ?? NaN, 6);
    expect(v).toBeCloseTo(expected[index]?.[1] ?? NaN, 6);
  });
});

test("what is behind the viewer is not drawn, and a line is cut where it comes in front", () => {
  const view = { position: [0, 0, 0], target: [0, 1, 0], up: [0, 0, 1] } as const;
  const projection = new Projection(view, SIZE);
  expect(projection.line([0, -1, 0], [1, -2, 0])).toBeNull();
  expect(projection.point([0, -1, 0])).toBeNull();
  const [from, to] = projection.line([0, -1, 0], [0, 2, 0]) ?? [[], []];
  expect([...from, ...to]).toEqual([350, 250, 350, 250]);
});
