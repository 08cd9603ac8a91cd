import type { Observation, PosedCamera } from "../api/types";
import { centerOf } from "../viewer/boxes";
import { rayOf } from "../viewer/poses";
import { cross, dot, subtract } from "../viewer/vectors";

type Box = NonNullable<Observation["changes"][number]["before"]>;

/** A square of a picture; as shares of its width. */
export interface Crop {
  left: number;
  top: number;
  side: number;
}

const AROUND = 1.6; // of the box, so that what stands beside it is seen, too

/** Where a camera's picture shows a box and what is around it; null for one that it does not show. */
export function cropOf(camera: PosedCamera, box: Box): Crop | null {
  const { position, forward, up } = rayOf(camera);
  const { width, height, fx, fy, cx, cy } = camera.intrinsics;
  const offset = subtract(centerOf(box), position);
  const depth = dot(offset, forward);
  const radius = Math.hypot(box.size.x, box.size.y, box.size.z) / 2;
  if (depth <= radius) return null;
  const [x, y] = [cx + (fx * dot(offset, cross(forward, up))) / depth, cy - (fy * dot(offset, up)) / depth];
  if (x < 0 || y < 0 || x > width || y > height) return null;
  const side = Math.min((2 * AROUND * radius * fx) / depth, width, height);
  const start = (middle: number, end: number) => Math.max(0, Math.min(middle - side / 2, end - side)) / width;
  return { left: start(x, width), top: start(y, height), side: side / width };
}

/** The camera of a smaller picture of the same. */
export function reduced(camera: PosedCamera, width: number): PosedCamera {
  const { intrinsics } = camera;
  const factor = Math.min(1, width / intrinsics.width);
  const [fx, fy, cx, cy] = [intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy].map((each) => each * factor);
  const size = { width: Math.round(intrinsics.width * factor), height: Math.round(intrinsics.height * factor) };
  return { ...camera, intrinsics: { ...intrinsics, ...size, fx: fx ?? 0, fy: fy ?? 0, cx: cx ?? 0, cy: cy ?? 0 } };
}
