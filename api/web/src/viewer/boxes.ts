import type { SceneObject } from "../api/types";
import type { Vec } from "./vectors";

type Box = NonNullable<SceneObject["box"]>;

export function centerOf(box: Box): Vec {
  const { x, y, z } = box.center.position;
  return [x, y, z];
}

/** The longest edge of a box. */
export function boxSize(box: Box): number {
  return Math.max(box.size.x, box.size.y, box.size.z);
}
