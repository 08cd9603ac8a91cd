import type { SplatColumns } from "./spz";
import type { Vec } from "./vectors";

const SAMPLES = 12_000;
const FAINT = -1; // logit of an opacity of 0.27
const WIDEST = 4; // cells: how far around its middle a sample covers
const SIGMAS = 1.25;

/** Where surfaces are, by a sample of the Gaussians: [3 count] and [count], scene units. */
export interface Surfaces {
  count: number;
  positions: Float32Array;
  radii: Float32Array;
}

/** A pinhole camera of a small picture, `width` × `height` cells, OpenCV axes. */
export interface GridCamera {
  position: Vec;
  right: Vec;
  down: Vec;
  forward: Vec;
  width: number;
  height: number;
  fx: number;
  fy: number;
  cx: number;
  cy: number;
}

/** What such a picture shows: of each cell the nearest sample, −1 for none, and its depth. */
export interface Grid {
  nearest: Int32Array;
  depths: Float32Array;
}

/** Every so many-th of the opaque Gaussians, enlarged to cover what those between do. */
export function surfacesOf({ count, columns }: SplatColumns, most = SAMPLES): Surfaces {
  const [x, y, z, opacity, a, b, c] = ["x", "y", "z", "opacity", "scale_0", "scale_1", "scale_2"].map(
    (name) => columns.get(name) ?? new Float32Array(count),
  ) as [Float32Array, Float32Array, Float32Array, Float32Array, Float32Array, Float32Array, Float32Array];
  const opaque: number[] = [];
  for (let row = 0; row < count; row++) if ((opacity[row] ?? 0) > FAINT) opaque.push(row);
  const step = Math.max(1, opaque.length / most);
  const kept = Math.floor(opaque.length / step);
  const [positions, radii] = [new Float32Array(3 * kept), new Float32Array(kept)];
  for (let sample = 0; sample < kept; sample++) {
    const row = opaque[Math.floor(sample * step)] ?? 0;
    positions.set([x[row] ?? 0, y[row] ?? 0, z[row] ?? 0], 3 * sample);
    const [, middle = 0] = [a[row] ?? 0, b[row] ?? 0, c[row] ?? 0].sort((one, other) => one - other);
    radii[sample] = SIGMAS * Math.exp(middle) * Math.sqrt(step);
  }
  return { count: kept, positions, radii };
}

/** Which cell of the picture a sample's middle is in and how deep it lies; null where the picture does not show it. */
export function cellOf(
  { positions }: Surfaces,
  sample: number,
  camera: GridCamera,
): { column: number; row: number; depth: number } | null {
  const { position: eye, right, down, forward } = camera;
  const x = (positions[3 * sample] ?? 0) - eye[0];
  const y = (positions[3 * sample + 1] ?? 0) - eye[1];
  const z = (positions[3 * sample + 2] ?? 0) - eye[2];
  const depth = x * forward[0] + y * forward[1] + z * forward[2];
  if (depth <= 1e-6) return null;
  const column = ((x * right[0] + y * right[1] + z * right[2]) / depth) * camera.fx + camera.cx;
  const row = ((x * down[0] + y * down[1] + z * down[2]) / depth) * camera.fy + camera.cy;
  const inside = column >= 0 && row >= 0 && column < camera.width && row < camera.height;
  return inside ? { column: Math.floor(column), row: Math.floor(row), depth } : null;
}

/** What a camera's picture shows of the surfaces. */
export function gridOf(surfaces: Surfaces, camera: GridCamera): Grid {
  const { width, height } = camera;
  const nearest = new Int32Array(width * height).fill(-1);
  const depths = new Float32Array(width * height).fill(Infinity);
  for (let sample = 0; sample < surfaces.count; sample++) {
    const at = cellOf(surfaces, sample, camera);
    if (!at) continue;
    const reach = Math.min(WIDEST, Math.floor((camera.fx * (surfaces.radii[sample] ?? 0)) / at.depth));
    for (let row = Math.max(0, at.row - reach); row <= Math.min(height - 1, at.row + reach); row++)
      for (let column = Math.max(0, at.column - reach); column <= Math.min(width - 1, at.column + reach); column++) {
        const cell = row * width + column;
        if (at.depth < (depths[cell] ?? 0)) {
          depths[cell] = at.depth;
          nearest[cell] = sample;
        }
      }
  }
  return { nearest, depths };
}
