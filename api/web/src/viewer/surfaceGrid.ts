import type { SplatColumns } from "./spz";
import type { Vec } from "./vectors";

const SAMPLES = 12_000;
const FAINT = -1; // logit of an opacity of 0.27
const WIDEST = 4; // cells: how far around its middle a sample of a surface covers
const SIGMAS = 1.25; // a square of so many to each side has about the area that a Gaussian covers
const NEAREST = 1e-6; // scene units: what is less deep is not before the camera
const BEFORE = 0.85; // of a surface's depth: fog is nearer, and what is not, the surface's own

/** Where surfaces are, by a sample of the Gaussians: [3 count] and [count], scene units. */
export interface Surfaces {
  count: number;
  positions: Float32Array;
  radii: Float32Array;
}

/** Faint Gaussians, and −log of the share of the light that each lets through. */
export interface Fog extends Surfaces {
  densities: Float32Array;
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
export function surfacesOf(splat: SplatColumns, most = SAMPLES): Surfaces {
  const opaque = column(splat, "opacity");
  const rows = [...opaque.keys()].filter((row) => (opaque[row] ?? 0) > FAINT);
  const step = Math.max(1, rows.length / most);
  const kept = Array.from(
    { length: Math.floor(rows.length / step) },
    (_, sample) => rows[Math.floor(sample * step)] ?? 0,
  );
  return placed(splat, kept, radiiOf(splat), Math.sqrt(step));
}

/** The largest of the faint Gaussians: small ones are on surfaces. */
export function fogOf(splat: SplatColumns, most = SAMPLES): Fog {
  const [opacity, radii] = [column(splat, "opacity"), radiiOf(splat)];
  const rows = [...opacity.keys()].filter((row) => (opacity[row] ?? 0) <= FAINT);
  const largest = rows.sort((one, other) => (radii[other] ?? 0) - (radii[one] ?? 0)).slice(0, most);
  const densities = Float32Array.from(largest, (row) => Math.log1p(Math.exp(opacity[row] ?? 0)));
  return { ...placed(splat, largest, radii), densities };
}

function column({ count, columns }: SplatColumns, name: string): Float32Array {
  return columns.get(name) ?? new Float32Array(count);
}

/** Of each Gaussian, by the second of its three sizes. */
function radiiOf(splat: SplatColumns): Float32Array {
  const [a, b, c] = ["scale_0", "scale_1", "scale_2"].map((name) => column(splat, name));
  return Float32Array.from({ length: splat.count }, (_, row) => {
    const [, middle = 0] = [a?.[row] ?? 0, b?.[row] ?? 0, c?.[row] ?? 0].sort((one, other) => one - other);
    return SIGMAS * Math.exp(middle);
  });
}

function placed(splat: SplatColumns, rows: readonly number[], radii: Float32Array, enlarged = 1): Surfaces {
  const axes = ["x", "y", "z"].map((name) => column(splat, name));
  return {
    count: rows.length,
    positions: Float32Array.from(rows.flatMap((row) => axes.map((axis) => axis[row] ?? 0))),
    radii: Float32Array.from(rows, (row) => enlarged * (radii[row] ?? 0)),
  };
}

/** Which cell of the picture, or beside it, a sample's middle is in and how deep it lies; null where that is behind. */
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
  if (depth <= NEAREST) return null;
  const column = ((x * right[0] + y * right[1] + z * right[2]) / depth) * camera.fx + camera.cx;
  const row = ((x * down[0] + y * down[1] + z * down[2]) / depth) * camera.fy + camera.cy;
  return { column: Math.floor(column), row: Math.floor(row), depth };
}

/** What a camera's picture shows of the surfaces. */
export function gridOf(surfaces: Surfaces, camera: GridCamera): Grid {
  const { width, height } = camera;
  const nearest = new Int32Array(width * height).fill(-1);
  const depths = new Float32Array(width * height).fill(Infinity);
  forPatches(surfaces, camera, WIDEST, (sample, depth, _share, top, bottom, left, right) => {
    for (let row = top; row <= bottom; row++)
      for (let cell = row * width + left; cell <= row * width + right; cell++)
        if (depth < (depths[cell] ?? 0)) {
          depths[cell] = depth;
          nearest[cell] = sample;
        }
  });
  return { nearest, depths };
}

/** Of each cell, −log of the share of the light that the fog before the surface there lets through. */
export function hazeOf(fog: Fog, camera: GridCamera, { depths }: Grid): Float32Array {
  const { width } = camera;
  const haze = new Float32Array(depths.length);
  const limits = depths.map((depth) => BEFORE * depth);
  forPatches(fog, camera, width, (sample, depth, share, top, bottom, left, right) => {
    const density = share * (fog.densities[sample] ?? 0);
    for (let row = top; row <= bottom; row++)
      for (let cell = row * width + left; cell <= row * width + right; cell++)
        if (depth < (limits[cell] ?? 0)) haze[cell] = (haze[cell] ?? 0) + density;
  });
  return haze;
}

/**
 * Calls with the cells that each sample covers: its depth, which share of each of these cells it covers, and the first and
 * last row and column of those in the picture. Every frame of a moving camera waits for this, so nothing is allocated.
 */
function forPatches(
  { count, positions, radii }: Surfaces,
  { position, right, down, forward, width, height, fx, fy, cx, cy }: GridCamera,
  widest: number,
  told: (sample: number, depth: number, share: number, top: number, bottom: number, left: number, end: number) => void,
): void {
  const [ex, ey, ez] = position;
  const [rx, ry, rz] = right;
  const [dx, dy, dz] = down;
  const [wx, wy, wz] = forward;
  for (let sample = 0; sample < count; sample++) {
    const x = (positions[3 * sample] ?? 0) - ex;
    const y = (positions[3 * sample + 1] ?? 0) - ey;
    const z = (positions[3 * sample + 2] ?? 0) - ez;
    const depth = x * wx + y * wy + z * wz;
    if (depth <= NEAREST) continue;
    const column = Math.floor(((x * rx + y * ry + z * rz) / depth) * fx + cx);
    const row = Math.floor(((x * dx + y * dy + z * dz) / depth) * fy + cy);
    const radius = (fx * (radii[sample] ?? 0)) / depth;
    const reach = Math.min(widest, Math.floor(radius));
    const [top, bottom] = [Math.max(0, row - reach), Math.min(height - 1, row + reach)];
    const [left, end] = [Math.max(0, column - reach), Math.min(width - 1, column + reach)];
    if (top <= bottom && left <= end)
      told(sample, depth, Math.min(1, ((2 * radius) / (2 * reach + 1)) ** 2), top, bottom, left, end);
  }
}
