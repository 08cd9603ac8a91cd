import type { Scene } from "../api/types";
import type { ExportFormat } from "../api/calls";

const BASES: readonly number[] = [0, 9, 24, 45];
const VIEWER_BYTES = 1_450_000;

/** About how many bytes a scene has as a file, as far as its number of Gaussians says it. */
export function exportBytes({ gaussians, quality }: Pick<Scene, "gaussians" | "quality">, format: ExportFormat) {
  const base = BASES[Number(quality["sh_degree"] ?? NaN)];
  if (base === undefined) return null; // what came from elsewhere
  const spz = 0.84 * (20 + base) * gaussians; // compressed by a sixth: measured at degrees 1 and 3
  const bytes: Partial<Record<ExportFormat, number>> = {
    ply: 4 * (17 + base) * gaussians,
    spz,
    sog: 18 * gaussians, // measured, too: 16.5 and 19.2
    html: (spz * 4) / 3 + VIEWER_BYTES,
  };
  return bytes[format] ?? null;
}
