import { expect, test } from "vitest";

import type { PosedCamera } from "../api/types";
import { cropOf, reduced } from "./changeCrop";

/** Looks along z, y down. */
const CAMERA = {
  name: "",
  convention: "OPENCV",
  frame_id: "world",
  position: { x: 0, y: 0, z: 0 },
  orientation: { x: 0, y: 0, z: 0, w: 1 },
  intrinsics: { width: 400, height: 300, fx: 200, fy: 200, cx: 200, cy: 150 },
} as PosedCamera;

const boxAt = (x: number, y: number, z: number) => ({
  center: { position: { x, y, z }, orientation: { x: 0, y: 0, z: 0, w: 1 } },
  size: { x: 0.2, y: 0, z: 0 },
});

test("a box is in the middle of its square", () => {
  const crop = cropOf(CAMERA, boxAt(0.5, -0.25, 2));
  expect(crop).not.toBeNull();
  const side = (2 * 1.6 * 0.1 * 200) / 2;
  expect(crop?.side).toBeCloseTo(side / 400);
  expect((crop?.left ?? 0) + (crop?.side ?? 0) / 2).toBeCloseTo(250 / 400);
  expect((crop?.top ?? 0) + (crop?.side ?? 0) / 2).toBeCloseTo(125 / 400);
});

test("a square stays inside the picture", () => {
  const near = cropOf(CAMERA, boxAt(0.95, 0.7, 1));
  expect((near?.left ?? 1) + (near?.side ?? 1)).toBeLessThanOrEqual(1 + 1e-9);
  expect((near?.top ?? 1) + (near?.side ?? 1)).toBeLessThanOrEqual(0.75 + 1e-9);
});

test("what is behind the camera or beside its picture has none", () => {
  for (const [x, y, z] of [
    [0, 0, -2],
    [0, 0, 0.05],
    [3, 0, 2],
    [0, 3, 2],
  ] as const)
    expect(cropOf(CAMERA, boxAt(x, y, z))).toBeNull();
});

test("a smaller picture shows the same", () => {
  const small = reduced(CAMERA, 100);
  expect(small.intrinsics).toMatchObject({ width: 100, height: 75, fx: 50, fy: 50, cx: 50, cy: 37.5 });
  expect(cropOf(small, boxAt(0.5, 0, 2))).toEqual(cropOf(CAMERA, boxAt(0.5, 0, 2)));
  expect(reduced(CAMERA, 1000).intrinsics.width).toBe(400);
});
