import type { Scene } from "../api/types";
import type { ExportFormat } from "../api/calls";

const BASES: readonly number[] = [0, 9, 24, 45];
const VIEWER_BYTES = 1_450_000;

type Facts = Pick<Scene, "gaussians" | "quality">;

/** How many bytes a scene has in a format; null: unknown. `spz`: of its SPZ file, which packs each scene differently. */
export function exportBytes({ gaussians, quality }: Facts, spz: number | null, format: ExportFormat): number | null {
  const base = BASES[Number(quality["sh_degree"] ?? NaN)]; // none of what came from elsewhere
  const bytes: Partial<Record<ExportFormat, number | null>> = {
    ply: base === undefined ? null : 4 * (17 + base) * gaussians,
    spz,
    sog: base === undefined ? null : 18 * gaussians, // measured at degrees 1 and 3: 16.5 and 19.2
    html: spz && (spz * 4) / 3 + VIEWER_BYTES,
  };
  return bytes[format] ?? null;
}
