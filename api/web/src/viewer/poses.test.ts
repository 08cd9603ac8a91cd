import { describe, expect, test } from "vitest";

import type { PosedCamera } from "../api/types";
import type { LookAt } from "./poses";
import {
  axesOf,
  between,
  cameraOf,
  centerOfAttention,
  firstView,
  fly,
  orbit,
  parseView,
  rayOf,
  turn,
  upOf,
  viewText,
  zoom,
} from "./poses";
import type { Vec } from "./vectors";
import { cross, dot, length, subtract, unit } from "./vectors";

const close = (a: Vec, b: Vec) => expect(length(subtract(a, b))).toBeLessThan(1e-6);
const view = (position: Vec, target: Vec, up: Vec = [0, 0, 1]): LookAt => ({ position, target, up });
const around = (angle: number, height: number, up: Vec = [0, 0, 1]): PosedCamera => {
  const position: Vec = up[2]
    ? [3 * Math.cos(angle), 3 * Math.sin(angle), height]
    : [3 * Math.cos(angle), height, 3 * Math.sin(angle)];
  return cameraOf(view(position, [0.5, 0.2, 0.1], up), 640, 480);
};

describe("a viewpoint as the service takes it", () => {
  test.each([0, 0.7, 2, 3.1, -2.5, -0.4])("has the axes of the view at heading %f", (angle) => {
    const looking = view([3 * Math.cos(angle), 3 * Math.sin(angle), 1.5], [0, 0, 0]);
    const { right, down, forward } = axesOf(looking);
    close(cross(right, down), forward);
    expect(dot(down, looking.up)).toBeLessThan(0);
    const ray = rayOf(cameraOf(looking, 640, 480));
    close(ray.forward, forward);
    close(ray.up, [-down[0], -down[1], -down[2]]);
    close(ray.position, looking.position);
  });

  test("keeps the field of view on the longer side", () => {
    const [wide, tall] = [
      cameraOf(view([0, -2, 0], [0, 0, 0]), 800, 400),
      cameraOf(view([0, -2, 0], [0, 0, 0]), 400, 800),
    ];
    expect(wide.intrinsics.fx).toBe(tall.intrinsics.fx);
    expect(wide.intrinsics.cx).toBe(400);
  });
});

describe("what is up", () => {
  test.each([[[0, 0, 1] as Vec], [[0, -1, 0] as Vec]])("is found from cameras on one side that look down: %s", (up) => {
    const sign = up[2] || -1;
    close(upOf([0, 0.4, 0.8].map((angle) => around(angle, 2 * sign, up))), up);
  });

  test("is the picture's own for one camera, and z for none", () => {
    const camera = around(0.3, 1);
    close(upOf([camera]), unit(rayOf(camera).up));
    close(upOf([]), [0, 0, 1]);
  });
});

test("the first view looks at what all cameras look at", () => {
  const cameras = [0, 1, 2.5].map((angle) => around(angle, 1.2));
  const center = centerOfAttention(cameras);
  expect(length(subtract(center, [0.5, 0.2, 0.1]))).toBeLessThan(0.02);
  const first = firstView(cameras);
  expect(length(subtract(first.target, center))).toBeLessThan(0.02);
  close(first.position, rayOf(cameras[1] as PosedCamera).position); // in the middle of where all were
});

describe("moving", () => {
  const start = view([2, -1, 1], [0, 0, 0.5]);
  const distance = length(subtract(start.position, start.target));

  test("orbit keeps the target and the distance, turn keeps the position", () => {
    const orbited = orbit(start, 0.4, 0.2);
    close(orbited.target, start.target);
    expect(length(subtract(orbited.position, orbited.target))).toBeCloseTo(distance, 9);
    close(orbit(orbited, -0.4, -0.2).position, start.position);
    close(turn(start, 0.3, 0).position, start.position);
  });

  test("orbit stops short of the zenith, so that upright stays defined", () => {
    const above = orbit(start, 0, 10);
    const { right, forward } = axesOf(above);
    expect(Math.abs(dot(forward, start.up))).toBeLessThan(0.9999);
    expect(length(right)).toBeCloseTo(1, 9);
  });

  test("fly moves both points, zoom the camera alone", () => {
    const flown = fly(start, 0, 0, 0.5);
    close(subtract(flown.target, flown.position), subtract(start.target, start.position));
    const near = zoom(start, 0.5);
    close(near.target, start.target);
    expect(length(subtract(near.position, near.target))).toBeCloseTo(distance / 2, 9);
  });

  test("a flight goes around what is looked at", () => {
    const goal = orbit(start, 2, 0);
    for (const share of [0, 0.25, 0.5, 0.75, 1]) {
      const way = between(start, goal, share);
      expect(length(subtract(way.position, way.target))).toBeCloseTo(distance, 9);
    }
    close(between(start, goal, 1).position, goal.position);
  });
});

describe("a view in an address", () => {
  test("comes back to six digits", () => {
    const start = view([2.123456789, -1, 1e-4], [0, 0, 0.5]);
    const back = parseView(viewText(start), [0, 0, 1]);
    expect(back && length(subtract(back.position, start.position))).toBeLessThan(1e-5);
  });

  test.each(["", "1_2_3", "1_2_3_4_5_x", "1_2_3_1_2_3", "1_2_3_4_5_6_7", "Infinity_0_0_0_0_0"])("%j is none", (text) =>
    expect(parseView(text, [0, 0, 1])).toBeNull(),
  );
});
