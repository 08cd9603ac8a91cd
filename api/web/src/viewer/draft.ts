import type { SplatColumns } from "./spz";

/** Gaussians of a draft, which slow machines draw while the camera moves. */
export const DRAFT_GAUSSIANS = 60_000;

/** Every so many-th Gaussian of a splat, enlarged to cover what those between did. */
export interface Draft {
  rows: Uint32Array<ArrayBuffer>;
  splat: SplatColumns;
}

/** A draft of at most `most` Gaussians without harmonics beside the constant one; null for a splat that is small anyway. */
export function draftOf({ count, columns }: SplatColumns, most = DRAFT_GAUSSIANS): Draft | null {
  if (count <= 2 * most) return null;
  const step = count / most;
  const rows = new Uint32Array(most).map((_, index) => Math.floor(index * step));
  const wider = 0.5 * Math.log(step); // an area times `step`, as a logarithm of its side
  const own = new Map<string, Float32Array>();
  for (const [name, data] of columns) {
    if (name.startsWith("f_rest_")) continue;
    const more = name.startsWith("scale_") ? wider : 0;
    own.set(
      name,
      Float32Array.from(rows, (row) => (data[row] ?? 0) + more),
    );
  }
  return { rows, splat: { count: most, columns: own } };
}

/** What belongs to the rows of a draft, `width` values each. */
export function ofRows(values: Uint8Array, rows: Uint32Array, width = 1): Uint8Array {
  const picked = new Uint8Array(rows.length * width);
  rows.forEach((row, index) => picked.set(values.subarray(row * width, (row + 1) * width), index * width));
  return picked;
}
