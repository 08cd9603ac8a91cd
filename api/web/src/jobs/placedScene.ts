import type { components } from "../api/schema";
import type { PosedCamera } from "../api/types";
import { upOf } from "../viewer/poses";
import { fromBase64 } from "../viewer/states";
import type { Vec } from "../viewer/vectors";
import { add, cross, dot, length, scale, subtract, unit } from "../viewer/vectors";

export type PlacedCameras = components["schemas"]["PlacedCameras"];

/** Cameras and points as they are drawn: in a box of about ±1 around their middle. */
export interface PlacedScene {
  points: Float32Array;
  colors: Uint8Array;
  /** Of each camera its center, then the corners of its picture. */
  frusta: readonly (readonly Vec[])[];
  up: Vec;
}

const FRUSTUM = 0.09;
const REACH = 0.9; // this share of the points decides how large the picture is: a few are far away

/** What a `PlacedCameras` shows; up is what the cameras take for it on average. */
export function placedScene(placed: PlacedCameras): PlacedScene {
  const bytes = fromBase64(placed.points);
  const points = new Float32Array(bytes.buffer, 0, Math.floor(bytes.length / 12) * 3);
  const centers = placed.cameras.map(({ position: { x, y, z } }): Vec => [x, y, z]);
  const all: Vec[] = [...centers];
  for (let at = 0; at < points.length; at += 3) all.push([points[at] ?? 0, points[at + 1] ?? 0, points[at + 2] ?? 0]);
  const middle: Vec = [0, 1, 2].map((axis) => median(all.map((point) => point[axis as 0 | 1 | 2]))) as unknown as Vec;
  const distances = all.map((point) => length(subtract(point, middle))).sort((a, b) => a - b);
  const farthestCamera = Math.max(0, ...centers.map((center) => length(subtract(center, middle))));
  const reach = Math.max(distances[Math.floor(REACH * (distances.length - 1))] ?? 1, farthestCamera) || 1;
  const moved = new Float32Array(points.length);
  for (let at = 0; at < points.length; at += 1) moved[at] = ((points[at] ?? 0) - middle[(at % 3) as 0 | 1 | 2]) / reach;
  const fitted = (point: Vec): Vec => scale(subtract(point, middle), 1 / reach);
  return {
    points: moved,
    colors: fromBase64(placed.colors),
    frusta: placed.cameras.map((camera, index) => frustum(camera, fitted(centers[index] ?? middle))),
    up: upOf(placed.cameras),
  };
}

/** The picture's axes for a look from all around (`turn`, radians) and from above (`tilt`). */
export function axesOfTurn(up: Vec, turn: number, tilt: number): { right: Vec; down: Vec; depth: Vec } {
  const aside: Vec = Math.abs(up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0];
  const [first, second] = [unit(cross(up, aside)), unit(cross(up, unit(cross(up, aside))))];
  const right = add(scale(first, Math.cos(turn)), scale(second, Math.sin(turn)));
  const level = cross(up, right);
  return {
    right,
    down: add(scale(up, -Math.cos(tilt)), scale(level, -Math.sin(tilt))),
    depth: add(scale(level, Math.cos(tilt)), scale(up, -Math.sin(tilt))),
  };
}

/** Where a point of the box is in a square picture of ±1, and how far behind its middle. */
export function projected(point: Vec, axes: { right: Vec; down: Vec; depth: Vec }): Vec {
  return [dot(point, axes.right), dot(point, axes.down), dot(point, axes.depth)];
}

function frustum(camera: PosedCamera, center: Vec): readonly Vec[] {
  const { width, height, fx, fy, cx, cy } = camera.intrinsics;
  const corners: readonly (readonly [number, number])[] = [
    [0, 0],
    [width, 0],
    [width, height],
    [0, height],
  ];
  const rays = corners.map(([x, y]): Vec => turned(camera, [(x - cx) / fx, (y - cy) / fy, 1]));
  return [center, ...rays.map((ray) => add(center, scale(ray, FRUSTUM)))];
}

/** A direction of the camera's frame in the world's. */
function turned(camera: PosedCamera, v: Vec): Vec {
  const { x, y, z, w } = camera.orientation;
  const axis: Vec = [x, y, z];
  const twice = scale(cross(axis, v), 2);
  return add(add(v, scale(twice, w)), cross(axis, twice));
}

function median(values: number[]): number {
  return values.sort((a, b) => a - b)[Math.floor(values.length / 2)] ?? 0;
}
