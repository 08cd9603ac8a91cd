import { expect, test } from "vitest";

import type { Vec } from "../viewer/vectors";
import { length, subtract } from "../viewer/vectors";
import { axesOfTurn, placedScene, projected } from "./placedScene";
import type { PlacedCameras } from "./placedScene";

const ORIGIN: Vec = [0, 0, 0];

const base64 = (bytes: Uint8Array) => btoa(String.fromCharCode(...bytes));

const camera = (x: number) => ({
  intrinsics: { width: 40, height: 30, fx: 30, fy: 30, cx: 20, cy: 15 },
  position: { x, y: 0, z: 0 },
  orientation: { x: 0, y: 0, z: 0, w: 1 },
  convention: "OPENCV" as const,
  frame_id: "world",
  name: "",
});

const placed: PlacedCameras = {
  info: { number: 1, placed: 2, images: 3, complete: true },
  cameras: [camera(100), camera(104)],
  points: base64(new Uint8Array(new Float32Array([101, 0, 2, 102, 0, 2, 103, 0, 2, 102, 1, 2]).buffer)),
  colors: base64(new Uint8Array(12).fill(200)),
};

test("cameras and points fit into the picture, and up is up", () => {
  const scene = placedScene(placed);
  expect(scene.points.length).toBe(12);
  expect(Math.max(...scene.points.map(Math.abs))).toBeLessThanOrEqual(1.001);
  const [first, second] = scene.frusta;
  expect(first).toHaveLength(5);
  const [a, b] = [first?.[0] ?? ORIGIN, second?.[0] ?? ORIGIN];
  expect(length(subtract(a, b))).toBeGreaterThan(1); // the cameras are the farthest apart
  expect(scene.up[1]).toBeCloseTo(-1); // OpenCV's y is down
});

test.each([0, 0.7, 2, 5])("turning by %d keeps lengths, and what is up is drawn up", (turn) => {
  const axes = axesOfTurn([0, 0, 1], turn, 0.4);
  expect(length(projected([0.3, -0.2, 0.5], axes))).toBeCloseTo(length([0.3, -0.2, 0.5]));
  expect(projected([0, 0, 1], axes)[1]).toBeLessThan(0);
});

test("nothing placed is nothing drawn", () => {
  const scene = placedScene({ ...placed, cameras: [], points: "", colors: "" });
  expect(scene.frusta).toEqual([]);
  expect(scene.points.length).toBe(0);
});
