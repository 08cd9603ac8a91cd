import type { Scene } from "../api/types";
import type { ExportFormat } from "../api/calls";

const BASES: readonly number[] = [0, 9, 24, 45];
const VIEWER_BYTES = 1_450_000;

/**
 * How many bytes a scene has as a file, as far as its number of Gaussians and the size of its SPZ file say it; null where
 * they do not. How well SPZ compresses is each scene's own.
 */
export function exportBytes(
  { gaussians, quality }: Pick<Scene, "gaussians" | "quality">,
  spz: number | null,
  format: ExportFormat,
): number | null {
  const base = BASES[Number(quality["sh_degree"] ?? NaN)]; // none of what came from elsewhere
  const bytes: Partial<Record<ExportFormat, number | null>> = {
    ply: base === undefined ? null : 4 * (17 + base) * gaussians,
    spz,
    sog: base === undefined ? null : 18 * gaussians, // measured at degrees 1 and 3: 16.5 and 19.2
    html: spz && (spz * 4) / 3 + VIEWER_BYTES,
  };
  return bytes[format] ?? null;
}
