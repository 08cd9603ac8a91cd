import type { SplatColumns } from "./spz";

/** Scenes of more Gaussians are shown with one band of harmonics: each further one costs memory and time for little. */
const MOST_WITH_ALL_BANDS = 500_000;
const ONE_BAND = 3; // harmonics beside the constant one

/** The same splat with one band of harmonics where it has more Gaussians than `most`; its columns may be shared. */
export function fewerBands({ count, columns }: SplatColumns, most = MOST_WITH_ALL_BANDS): SplatColumns {
  const rest = [...columns.keys()].filter((name) => name.startsWith("f_rest_")).length;
  const each = rest / 3; // one channel after another
  if (count <= most || each <= ONE_BAND) return { count, columns };
  const kept = new Map([...columns].filter(([name]) => !name.startsWith("f_rest_")));
  for (let channel = 0; channel < 3; channel++)
    for (let harmonic = 0; harmonic < ONE_BAND; harmonic++) {
      const data = columns.get(`f_rest_${channel * each + harmonic}`);
      if (data) kept.set(`f_rest_${channel * ONE_BAND + harmonic}`, data);
    }
  return { count, columns: kept };
}
