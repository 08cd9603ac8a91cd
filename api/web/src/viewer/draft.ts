import type { SplatColumns } from "./spz";

/** Gaussians of a draft: a third of the splat's, between these. */
const [LEAST, MOST] = [12_000, 60_000];
const FEWEST = 6_000;
const [SAMPLES, ROUNDS] = [10_000, 60];
const SOLID = 0.99; // the largest opacity that a Gaussian of a draft gets

/** Some Gaussians of a splat, each standing for those that were left out. */
export interface Draft {
  rows: Uint32Array<ArrayBuffer>;
  splat: SplatColumns;
}

/**
 * What slow machines draw while the camera moves: fewer Gaussians, of one color from all sides.
 *
 * The more a Gaussian covers, the surer it stays; those that cover most stay as they are. Another one stays by a share
 * of its kind and covers (opacity by area) for the rest of them: more opaque, and where that does not do, larger.
 *
 * @param most how many Gaussians, about.
 * @returns null for a splat that is small anyway.
 */
export function draftOf(
  { count, columns }: SplatColumns,
  most = Math.min(MOST, Math.max(LEAST, count / 3)),
): Draft | null {
  if (count <= 1.5 * most) return null;
  const column = (name: string) => columns.get(name) ?? new Float32Array(count);
  const [logits, ...scales] = ["opacity", "scale_0", "scale_1", "scale_2"].map(column) as [
    Float32Array,
    ...Float32Array[],
  ];
  const opacities = Float64Array.from(logits, (logit) => 1 / (1 + Math.exp(-logit)));
  const covers = opacities.map((opacity, row) => {
    const sizes = scales.map((scale) => scale[row] ?? 0);
    const [one = 0, two = 0, three = 0] = sizes;
    return opacity * Math.exp((one + two + three - Math.min(...sizes)) / 2);
  });
  const rate = rateOf(covers, most);
  const [rows, shares]: [number[], number[]] = [[], []];
  let sum = 0.5;
  covers.forEach((cover, row) => {
    const share = Math.min(1, rate * cover);
    sum += share;
    if (sum < 1) return;
    sum -= 1;
    rows.push(row);
    shares.push(share);
  });
  const own = new Map<string, Float32Array>();
  for (const [name, data] of columns)
    if (!name.startsWith("f_rest_"))
      own.set(
        name,
        Float32Array.from(rows, (row) => data[row] ?? 0),
      );
  rows.forEach((row, at) => {
    const [opacity, stands] = [opacities[row] ?? 0, 1 / (shares[at] ?? 1)];
    if (stands <= 1) return;
    const denser = Math.max(opacity, Math.min(SOLID, 1 - (1 - opacity) ** stands));
    const wider = Math.max(0, 0.5 * Math.log((stands * opacity) / denser));
    own.get("opacity")?.fill(Math.log(denser / (1 - denser)), at, at + 1);
    for (const name of ["scale_0", "scale_1", "scale_2"]) {
      const data = own.get(name);
      if (data) data[at] = (data[at] ?? 0) + wider;
    }
  });
  return { rows: Uint32Array.from(rows), splat: { count: rows.length, columns: own } };
}

/** A draft of a draft: about a share of its Gaussians, never fewer than `FEWEST`; null where those are hardly fewer. */
export function thinner(draft: Draft, share: number): Draft | null {
  const thin = draftOf(draft.splat, Math.max(FEWEST, share * draft.splat.count));
  return thin && { ...thin, rows: thin.rows.map((row) => draft.rows[row] ?? 0) };
}

/** By which covers are multiplied to be shares, at most 1 each, that sum up to about `most`. */
function rateOf(covers: Float64Array, most: number): number {
  const step = Math.max(1, Math.floor(covers.length / SAMPLES));
  const some = covers.filter((_, row) => row % step === 0);
  let [low, high] = [0, most / Math.max(1e-30, Math.min(...some.filter((cover) => cover > 0)))];
  for (let round = 0; round < ROUNDS; round++) {
    const middle = (low + high) / 2;
    const sum = some.reduce((all, cover) => all + Math.min(1, middle * cover), 0);
    if (sum * step < most) low = middle;
    else high = middle;
  }
  return high;
}

/** What belongs to the rows of a draft, `width` values each. */
export function ofRows(values: Uint8Array, rows: Uint32Array, width = 1): Uint8Array {
  const picked = new Uint8Array(rows.length * width);
  rows.forEach((row, index) => picked.set(values.subarray(row * width, (row + 1) * width), index * width));
  return picked;
}
