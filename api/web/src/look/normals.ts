import { rayOf } from "../viewer/poses";
import type { PosedCamera } from "../api/types";
import { add, scale } from "../viewer/vectors";
import type { Vec } from "../viewer/vectors";

const NAMES = ["x", "y", "z", "rot_0", "rot_1", "rot_2", "rot_3", "scale_0", "scale_1", "scale_2"];

/** The mean of where the cameras stand. */
export function middleOf(cameras: readonly PosedCamera[]): Vec {
  const sum = cameras.map((camera) => rayOf(camera).position).reduce(add, [0, 0, 0]);
  return scale(sum, 1 / Math.max(cameras.length, 1));
}

/**
 * The direction of each Gaussian's smallest extent, turned towards a point, as RGBA: (n + 1) / 2 of world x, y, z; 255.
 *
 * @param columns of a 3DGS PLY.
 */
export function normalTints(columns: ReadonlyMap<string, Float32Array>, towards: Vec): Uint8Array {
  const [px, py, pz, rw, rx, ry, rz, ...scales] = NAMES.map((name) => columns.get(name) ?? new Float32Array());
  const count = px?.length ?? 0;
  const tints = new Uint8Array(4 * count);
  for (let row = 0; row < count; row++) {
    const at = (column: Float32Array | undefined) => column?.[row] ?? 0;
    const length = Math.hypot(at(rw), at(rx), at(ry), at(rz)) || 1;
    const [w, x, y, z] = [at(rw) / length, at(rx) / length, at(ry) / length, at(rz) / length];
    const sizes = scales.map(at);
    const axis = sizes.indexOf(Math.min(...sizes));
    const normal: Vec =
      axis === 0
        ? [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
        : axis === 1
          ? [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)]
          : [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)];
    const [tx, ty, tz] = [towards[0] - at(px), towards[1] - at(py), towards[2] - at(pz)];
    const sign = normal[0] * tx + normal[1] * ty + normal[2] * tz < 0 ? -1 : 1;
    for (let channel = 0; channel < 3; channel++)
      tints[4 * row + channel] = Math.round((sign * (normal[channel] ?? 0) + 1) * 127.5);
    tints[4 * row + 3] = 255;
  }
  return tints;
}
