import type { Pose, PosedCamera } from "../api/types";
import { damped, outerSum, solve, times } from "./linear";
import type { Vec } from "./vectors";
import { add, cross, dot, length, mix, scale, subtract, unit } from "./vectors";

/** From where the scene is looked at: from `position` to `target`, with the unit vector `up` upright in the picture. */
export interface LookAt {
  position: Vec;
  target: Vec;
  up: Vec;
  /** Where it is not `FIELD_OF_VIEW`: at a photo. */
  fieldOfView?: number;
  /** What is up in the scene, where `up` is only what is upright in a photo that was held askew. */
  level?: Vec;
}

/** The field of view along the longer side of the picture, degrees. */
export const FIELD_OF_VIEW = 55;

const STEEPEST = 0.998; // sine of the angle to the horizon: beyond it "upright" is not defined
const NEAREST = 1e-3;

/** The camera's axes in the world frame, OpenCV: x right, y down, z forward. */
export function axesOf({ position, target, up }: LookAt): { right: Vec; down: Vec; forward: Vec } {
  const forward = unit(subtract(target, position));
  const right = unit(cross(forward, up));
  return { right, down: cross(forward, right), forward };
}

/** Focal length in pixels of a picture of `width` × `height`. */
export function focalLength(width: number, height: number, fieldOfView = FIELD_OF_VIEW): number {
  return Math.max(width, height) / 2 / Math.tan((fieldOfView * Math.PI) / 360);
}

/** The viewpoint as the service takes it: a pinhole camera with OpenCV axes. */
export function cameraOf(view: LookAt, width: number, height: number): PosedCamera {
  const { right, down, forward } = axesOf(view);
  const focal = focalLength(width, height, view.fieldOfView);
  return {
    intrinsics: { width, height, fx: focal, fy: focal, cx: width / 2, cy: height / 2 },
    position: { x: view.position[0], y: view.position[1], z: view.position[2] },
    orientation: quaternionOf(right, down, forward),
    convention: "OPENCV",
    frame_id: "world",
    name: "",
  };
}

/** Where one stands and looks, OpenCV axes. */
export function poseOf(view: LookAt): Pose {
  const { position, orientation } = cameraOf(view, 1, 1);
  return { position, orientation };
}

/** The unit quaternion of the rotation whose columns are x, y and z (Shepperd's method). */
export function quaternionOf(x: Vec, y: Vec, z: Vec): { x: number; y: number; z: number; w: number } {
  const trace = x[0] + y[1] + z[2];
  if (trace > 0) {
    const s = 2 * Math.sqrt(trace + 1);
    return { w: s / 4, x: (y[2] - z[1]) / s, y: (z[0] - x[2]) / s, z: (x[1] - y[0]) / s };
  }
  if (x[0] > y[1] && x[0] > z[2]) {
    const s = 2 * Math.sqrt(1 + x[0] - y[1] - z[2]);
    return { w: (y[2] - z[1]) / s, x: s / 4, y: (y[0] + x[1]) / s, z: (z[0] + x[2]) / s };
  }
  if (y[1] > z[2]) {
    const s = 2 * Math.sqrt(1 + y[1] - x[0] - z[2]);
    return { w: (z[0] - x[2]) / s, x: (y[0] + x[1]) / s, y: s / 4, z: (z[1] + y[2]) / s };
  }
  const s = 2 * Math.sqrt(1 + z[2] - x[0] - y[1]);
  return { w: (x[1] - y[0]) / s, x: (z[0] + x[2]) / s, y: (z[1] + y[2]) / s, z: s / 4 };
}

/** The position of one of the scene's own cameras, its forward axis, and what is up in its picture. */
export function rayOf(camera: PosedCamera): { position: Vec; forward: Vec; up: Vec } {
  const { x, y, z, w } = camera.orientation;
  return {
    position: [camera.position.x, camera.position.y, camera.position.z],
    forward: [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
    up: [-2 * (x * y - w * z), -(1 - 2 * (x * x + z * z)), -2 * (y * z + w * x)],
  };
}

/** Where one looks from and to with a camera, from as far from the middle as now. */
export function lookFrom(camera: PosedCamera, now: LookAt): LookAt {
  const { position, forward, up } = rayOf(camera);
  const reach = length(subtract(now.target, position));
  return { ...now, position, target: add(position, scale(forward, reach)), up };
}

/** The scene's up, by which all pictures' horizons are level; where undecided, their mean up; z without pictures. */
export function upOf(cameras: readonly PosedCamera[]): Vec {
  const rays = cameras.map(rayOf);
  const mean = rays.map((ray) => ray.up).reduce(add, [0, 0, 0]);
  if (length(mean) < 1e-6) return [0, 0, 1];
  const horizons = damped(outerSum(rays.map((ray) => unit(cross(ray.forward, ray.up)))), 1e-3 * cameras.length);
  let up = unit(mean);
  for (let round = 0; round < 20; round++) up = unit(solve(horizons, up)); // inverse iteration: the smallest eigenvector
  return up;
}

/** The point that is nearest to all optical axes (least squares); near the cameras' mean where the axes are parallel. */
export function centerOfAttention(cameras: readonly PosedCamera[]): Vec {
  const rays = cameras.map(rayOf);
  const damping = 1e-3;
  const right = rays
    .map((ray) => add(times(outerSum([ray.forward], true), ray.position), scale(ray.position, damping)))
    .reduce(add, [0, 0, 0]);
  const normal = outerSum(
    rays.map((ray) => ray.forward),
    true,
  );
  return solve(damped(normal, damping * cameras.length), right);
}

/** The camera in the middle of where all were: the one that is least far from the others. */
export function middleCamera(cameras: readonly PosedCamera[]): PosedCamera | null {
  const positions = cameras.map((camera) => rayOf(camera).position);
  const away = positions.map((one) => positions.reduce((sum, other) => sum + length(subtract(one, other)), 0));
  return cameras[away.indexOf(Math.min(...away))] ?? null;
}

/** Where to look from first: the camera in the middle of where all were, upright, at what all cameras look at. */
export function firstView(cameras: readonly PosedCamera[]): LookAt {
  const middle = middleCamera(cameras);
  const up = upOf(cameras);
  if (!middle) return { position: [0, -2, 1], target: [0, 0, 0], up };
  const { position, forward } = rayOf(middle);
  const center = centerOfAttention(cameras);
  const ahead = dot(subtract(center, position), forward) > NEAREST;
  return { position, target: ahead ? center : add(position, scale(forward, 0.1)), up };
}

/** Turns the camera around its target. Angles in radians; up and down ends before the zenith. */
export function orbit(from: LookAt, yaw: number, pitch: number): LookAt {
  const view = leveled(from);
  const offset = subtract(view.position, view.target);
  return { ...view, position: add(view.target, turned(offset, view.up, yaw, pitch)) };
}

/** Turns the camera's head where it stands. */
export function turn(from: LookAt, yaw: number, pitch: number): LookAt {
  const view = leveled(from);
  const offset = subtract(view.target, view.position);
  return { ...view, target: add(view.position, turned(offset, view.up, yaw, pitch)) };
}

/** Moves camera and target by shares of their distance: to the right, up in the picture, and forward. */
export function fly(view: LookAt, right: number, up: number, forward: number): LookAt {
  const axes = axesOf(view);
  const distance = length(subtract(view.target, view.position));
  const way = add(add(scale(axes.right, right), scale(axes.down, -up)), scale(axes.forward, forward));
  const step = scale(way, distance);
  return { ...view, position: add(view.position, step), target: add(view.target, step) };
}

/** Moves the camera towards its target: the distance is multiplied by `factor`. */
export function zoom(view: LookAt, factor: number): LookAt {
  const offset = subtract(view.position, view.target);
  const distance = Math.max(length(offset) * factor, NEAREST);
  return { ...view, position: add(view.target, scale(unit(offset), distance)) };
}

/** The same view of a scene whose lengths were multiplied by `factor`. */
export function rescaled(view: LookAt, factor: number): LookAt {
  return { ...view, position: scale(view.position, factor), target: scale(view.target, factor) };
}

/** The view at `share` (0..1) of the way between two, around what is looked at: not through the middle of it. */
export function between(from: LookAt, to: LookAt, share: number): LookAt {
  const [wide, narrow] = [from.fieldOfView ?? FIELD_OF_VIEW, to.fieldOfView ?? FIELD_OF_VIEW];
  const target = mix(from.target, to.target, share);
  const [begin, end] = [subtract(from.position, from.target), subtract(to.position, to.target)];
  const distance = length(begin) * (1 - share) + length(end) * share;
  return {
    ...to,
    position: share < 1 ? add(target, scale(unit(mix(unit(begin), unit(end), share)), distance)) : to.position,
    target,
    up: unit(mix(from.up, to.up, share)),
    fieldOfView: wide + (narrow - wide) * share,
  };
}

/** The same view with the scene's horizon level, where a photo's was not. */
function leveled({ level, ...view }: LookAt): LookAt {
  return { ...view, up: level ?? view.up };
}

/** The view as text for an address: six numbers. */
export function viewText({ position, target }: LookAt): string {
  return [...position, ...target].map((value) => Number(value.toPrecision(6))).join("_");
}

/** The view of an address, or null for a text that is none. What is up, the scene says. */
export function parseView(text: string, up: Vec): LookAt | null {
  const numbers = text.split("_").map(Number);
  const [a, b, c, d, e, f] = numbers;
  if (numbers.length !== 6 || !numbers.every(Number.isFinite) || text.trim() === "") return null;
  if (a === undefined || b === undefined || c === undefined || d === undefined || e === undefined || f === undefined)
    return null;
  const view: LookAt = { position: [a, b, c], target: [d, e, f], up };
  return length(subtract(view.target, view.position)) >= NEAREST ? view : null;
}

/** An offset turned by `yaw` around `up` and raised by `pitch`, short of the zenith. */
function turned(offset: Vec, up: Vec, yaw: number, pitch: number): Vec {
  const distance = length(offset);
  const helper: Vec = Math.abs(up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0];
  const east = unit(subtract(helper, scale(up, dot(helper, up))));
  const north = cross(up, east);
  const heading = Math.atan2(dot(offset, north), dot(offset, east)) + yaw;
  const limit = Math.asin(STEEPEST);
  const sine = Math.max(-1, Math.min(1, dot(offset, up) / distance));
  const height = Math.min(limit, Math.max(-limit, Math.asin(sine) + pitch));
  const flat = Math.cos(height) * distance;
  const level = add(scale(east, flat * Math.cos(heading)), scale(north, flat * Math.sin(heading)));
  return add(level, scale(up, distance * Math.sin(height)));
}
