import { expect, test } from "vitest";

import { exportBytes } from "./exportSizes";

// Files of two scenes: the packaged sample, and the same capture trained at the third degree.
test.each([
  [13_807, 1, { ply: 1_436_559, spz: 352_590, sog: 228_475, html: 1_921_302 }],
  [39_486, 3, { ply: 9_794_058, spz: 2_073_817, sog: 757_311, html: 4_217_400 }],
] as const)("%i Gaussians of degree %i: sizes are told within a tenth", (gaussians, degree, files) => {
  for (const format of ["ply", "spz", "sog", "html"] as const) {
    const told = exportBytes({ gaussians, quality: { sh_degree: degree } }, files.spz, format) ?? 0;
    expect(Math.abs(told / files[format] - 1)).toBeLessThan(0.1);
  }
});

test("nothing is told where nothing says it", () => {
  expect(exportBytes({ gaussians: 100, quality: {} }, null, "ply")).toBeNull();
  for (const format of ["mesh", "spz", "html"] as const)
    expect(exportBytes({ gaussians: 100, quality: { sh_degree: 3 } }, null, format)).toBeNull();
});
