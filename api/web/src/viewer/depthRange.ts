import type { LookAt } from "./poses";
import { axesOf, FIELD_OF_VIEW } from "./poses";

const SAMPLES = 4_096;
const FAINT = -1; // logit of an opacity of 0.27
const [NEAR, FAR] = [0.02, 0.9]; // shares of the Gaussians in view that are nearer

/** How far the Gaussians in view are, by a sample of them. */
export class DepthRange {
  readonly #points: readonly (readonly [number, number, number])[];

  /** @param columns of a 3DGS PLY. */
  constructor(columns: ReadonlyMap<string, Float32Array>) {
    const [x, y, z, opacity] = ["x", "y", "z", "opacity"].map((name) => columns.get(name) ?? new Float32Array());
    const points: [number, number, number][] = [];
    const count = x?.length ?? 0;
    const step = Math.max(1, count / SAMPLES);
    for (let at = 0; at < count; at += step) {
      const row = Math.floor(at);
      if ((opacity?.[row] ?? 0) > FAINT) points.push([x?.[row] ?? 0, y?.[row] ?? 0, z?.[row] ?? 0]);
    }
    this.#points = points;
  }

  /** Nearest and farthest depth along a view, without outliers, scene units; of all Gaussians where none is in view. */
  of(view: LookAt): readonly [number, number] {
    const { right, down, forward } = axesOf(view);
    const limit = Math.tan(((view.fieldOfView ?? FIELD_OF_VIEW) * Math.PI) / 360);
    const [inView, all]: [number[], number[]] = [[], []];
    for (const [x, y, z] of this.#points) {
      const [dx, dy, dz] = [x - view.position[0], y - view.position[1], z - view.position[2]];
      const depth = dx * forward[0] + dy * forward[1] + dz * forward[2];
      const across = Math.abs(dx * right[0] + dy * right[1] + dz * right[2]);
      const along = Math.abs(dx * down[0] + dy * down[1] + dz * down[2]);
      all.push(depth);
      if (depth > 0 && Math.max(across, along) < limit * depth) inView.push(depth);
    }
    const depths = (inView.length ? inView : all).sort((a, b) => a - b);
    const near = depths[Math.floor(depths.length * NEAR)] ?? 0;
    const far = depths[Math.floor(depths.length * FAR)] ?? 1;
    return [near, far > near ? far : near + 1e-6];
  }
}
