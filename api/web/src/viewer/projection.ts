import type { PosedCamera } from "../api/types";
import type { LookAt } from "./poses";
import { axesOf, centerOfAttention, focalLength, rayOf } from "./poses";
import type { Vec } from "./vectors";
import { add, cross, dot, length, scale, subtract } from "./vectors";

/** The size of the picture that is drawn over, CSS pixels. */
export interface Size {
  width: number;
  height: number;
}

/** A rectangle of that picture. */
interface Rect extends Size {
  left: number;
  top: number;
}

export type Point = readonly [number, number];

/** A point in a path of SVG. */
export const pathPoint = ([x, y]: Point): string => `${x.toFixed(1)} ${y.toFixed(1)}`;

const NEAR = 0.02; // of the distance to the target: what is nearer is not drawn

/** A view's pinhole camera, ready to project many points. */
export class Projection {
  readonly #axes: ReturnType<typeof axesOf>;
  readonly #focal: number;
  readonly #near: number;

  constructor(
    private readonly view: LookAt,
    private readonly size: Size,
  ) {
    this.#axes = axesOf(view);
    this.#focal = focalLength(size.width, size.height, view.fieldOfView);
    const offset = subtract(view.target, view.position);
    this.#near = NEAR * Math.sqrt(dot(offset, offset));
  }

  /** Where a point of the world is, in pixels; null behind the camera. */
  point(point: Vec): Point | null {
    return this.line(point, point)?.[0] ?? null;
  }

  /** The part of a line between two points of the world that is in front of the camera, in pixels; null for none. */
  line(from: Vec, to: Vec): readonly [Point, Point] | null {
    let [a, b] = [this.#inCamera(from), this.#inCamera(to)];
    if (a[2] < this.#near && b[2] < this.#near) return null;
    if (a[2] < this.#near) a = this.#cut(a, b);
    else if (b[2] < this.#near) b = this.#cut(b, a);
    return [this.#pixel(a), this.#pixel(b)];
  }

  #inCamera(point: Vec): Vec {
    const offset = subtract(point, this.view.position);
    return [dot(offset, this.#axes.right), dot(offset, this.#axes.down), dot(offset, this.#axes.forward)];
  }

  #cut(behind: Vec, ahead: Vec): Vec {
    const share = (this.#near - behind[2]) / (ahead[2] - behind[2]);
    return add(behind, scale(subtract(ahead, behind), share));
  }

  #pixel([x, y, z]: Vec): Point {
    return [this.size.width / 2 + (this.#focal * x) / z, this.size.height / 2 + (this.#focal * y) / z];
  }
}

/** The corners of a camera's picture at a depth: top left, top right, bottom right, bottom left; and its position. */
export function frustumOf(camera: PosedCamera, depth: number): { apex: Vec; corners: readonly [Vec, Vec, Vec, Vec] } {
  const { position, forward, up } = rayOf(camera);
  const [down, right] = [scale(up, -1), cross(forward, up)];
  const { width, height, fx, fy, cx, cy } = camera.intrinsics;
  const corner = (u: number, v: number): Vec =>
    add(
      position,
      add(scale(forward, depth), add(scale(right, ((u - cx) / fx) * depth), scale(down, ((v - cy) / fy) * depth))),
    );
  return { apex: position, corners: [corner(0, 0), corner(width, 0), corner(width, height), corner(0, height)] };
}

/** The view from a photo's place that shows it whole; `distance` to the target in scene units, `level` is up. */
export function viewOfPhoto(camera: PosedCamera, distance: number, level: Vec, size: Size): LookAt {
  const { position, forward, up } = rayOf(camera);
  const { width, height, fx, fy, cx, cy } = camera.intrinsics;
  const focal = Math.min(
    (fx * size.width) / 2 / Math.max(cx, width - cx, 1),
    (fy * size.height) / 2 / Math.max(cy, height - cy, 1),
  );
  const fieldOfView = (Math.atan(Math.max(size.width, size.height) / 2 / focal) * 360) / Math.PI;
  return { position, target: add(position, scale(forward, distance)), up, fieldOfView, level };
}

/** A camera's picture in a view from the same place: a scale of each axis and a shift, exact for any intrinsics. */
export function photoRect(camera: PosedCamera, view: LookAt, size: Size): Rect {
  const focal = focalLength(size.width, size.height, view.fieldOfView);
  const { width, height, fx, fy, cx, cy } = camera.intrinsics;
  return {
    left: size.width / 2 - (focal * cx) / fx,
    top: size.height / 2 - (focal * cy) / fy,
    width: (focal * width) / fx,
    height: (focal * height) / fy,
  };
}

/** The length to which cameras are drawn: a share of how far they usually are from what they look at. */
export function drawnDepth(cameras: readonly PosedCamera[]): number {
  const center = centerOfAttention(cameras);
  const distances = cameras.map((camera) => length(subtract(rayOf(camera).position, center))).sort((a, b) => a - b);
  return 0.1 * (distances[distances.length >> 1] ?? 1);
}
