import type { PhotoVerdict } from "../api/types";

/** What the pixels of one photo say; the server measures and judges the same way, see `photo_quality.py`. */
export interface PhotoQuality {
  /** Standard deviation of the Laplacian: falls with blur. */
  detail: number;
  /** Standard deviation of the gray values, 0..255. */
  contrast: number;
  /** The 90th percentile of the gray values, 0..1. */
  brightness: number;
  /** Gray values of a picture of 16 × 16. */
  thumbnail: Float32Array;
}

export type Defect = PhotoVerdict["defects"][number];

/** Longer side of the picture that is measured, pixels. */
export const MEASURED_SIDE = 800;
const THUMBNAIL = 16;
const MIN_SHARPNESS = 0.5;
const MIN_CRISPNESS = 0.6;
const MIN_SET = 3;
const MIN_BRIGHTNESS = 0.16;
const SAME_PIXELS = 3;

/** The quality of RGBA bytes [height, width, 4]. */
export function measured(pixels: Uint8ClampedArray, width: number, height: number): PhotoQuality {
  const gray = new Float32Array(width * height); // the green channel is the sharpest, and close to luminance
  for (let at = 0; at < gray.length; at++) gray[at] = pixels[4 * at + 1] ?? 0;
  const value = (x: number, y: number) => gray[y * width + x] ?? 0;
  const laplacian = new Float32Array(Math.max(0, width - 2) * Math.max(0, height - 2));
  let next = 0;
  for (let y = 1; y < height - 1; y++)
    for (let x = 1; x < width - 1; x++)
      laplacian[next++] = value(x - 1, y) + value(x + 1, y) + value(x, y - 1) + value(x, y + 1) - 4 * value(x, y);
  return {
    detail: deviation(laplacian),
    contrast: deviation(gray),
    brightness: (Float32Array.from(gray).sort()[Math.floor(0.9 * (gray.length - 1))] ?? 0) / 255,
    thumbnail: reduced(gray, width, height),
  };
}

/** What is wrong with each photo beside the others, by its key; of photos that show the same the sharpest is none. */
export function judged(photos: ReadonlyMap<string, PhotoQuality>): Map<string, Defect[]> {
  const all = [...photos].sort(([, one], [, other]) => other.detail - one.detail);
  const sharp = median(all.map(([, { detail }]) => detail)) || 1;
  const crisp = median(all.map(([, photo]) => crispness(photo))) || 1;
  const kept: PhotoQuality[] = [];
  return new Map(
    all.map(([key, photo]) => {
      const blurred =
        all.length >= MIN_SET && photo.detail < MIN_SHARPNESS * sharp && crispness(photo) < MIN_CRISPNESS * crisp;
      const same = kept.some((other) => distance(photo.thumbnail, other.thumbnail) < SAME_PIXELS);
      if (!same) kept.push(photo);
      const defects = { blurred, dark: photo.brightness < MIN_BRIGHTNESS, duplicate: same };
      return [key, (Object.keys(defects) as Defect[]).filter((name) => defects[name])];
    }),
  );
}

const crispness = ({ detail, contrast }: PhotoQuality): number => detail / Math.max(contrast, 1);

function deviation(values: Float32Array): number {
  const mean = values.reduce((sum, value) => sum + value, 0) / Math.max(values.length, 1);
  return Math.sqrt(values.reduce((sum, value) => sum + (value - mean) ** 2, 0) / Math.max(values.length, 1));
}

/** Means of 16 × 16 fields. */
function reduced(gray: Float32Array, width: number, height: number): Float32Array {
  const sums = new Float32Array(THUMBNAIL ** 2);
  const counts = new Float32Array(THUMBNAIL ** 2);
  for (let y = 0; y < height; y++) {
    const row = Math.floor((y * THUMBNAIL) / height) * THUMBNAIL;
    for (let x = 0; x < width; x++) {
      const field = row + Math.floor((x * THUMBNAIL) / width);
      sums[field] = (sums[field] ?? 0) + (gray[y * width + x] ?? 0);
      counts[field] = (counts[field] ?? 0) + 1;
    }
  }
  return sums.map((sum, field) => sum / Math.max(counts[field] ?? 0, 1));
}

function distance(one: Float32Array, other: Float32Array): number {
  return Math.sqrt(one.reduce((sum, value, at) => sum + (value - (other[at] ?? 0)) ** 2, 0) / one.length);
}

function median(values: readonly number[]): number {
  const ordered = [...values].sort((one, other) => one - other);
  return ordered[Math.floor(ordered.length / 2)] ?? 0;
}
