import type { LookAt } from "../viewer/poses";
import { axesOf, focalLength } from "../viewer/poses";
import type { Vec } from "../viewer/vectors";
import { dot, subtract } from "../viewer/vectors";

/** Where a picture of `width` × `height` shows a point, in its pixels; null behind the camera. */
export function projected(
  view: LookAt,
  { width, height }: { width: number; height: number },
  point: Vec,
): { x: number; y: number } | null {
  const { right, down, forward } = axesOf(view);
  const away = subtract(point, view.position);
  const depth = dot(away, forward);
  if (depth <= 1e-6) return null;
  const focal = focalLength(width, height);
  return { x: width / 2 + (focal * dot(away, right)) / depth, y: height / 2 + (focal * dot(away, down)) / depth };
}
