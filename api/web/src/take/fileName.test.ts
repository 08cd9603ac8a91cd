import { expect, test } from "vitest";

import { fileName } from "./fileName";

test.each([
  ["my table", "my table.ply"],
  ["../../etc/passwd", "etc_passwd.ply"],
  ["<b>Küche</b>", "b_Küche_b.ply"],
  ["a\u0000b\nc:d|e", "a_b_c_d_e.ply"],
  ["...", "scene.ply"],
  ["", "scene.ply"],
  ["x".repeat(200), `${"x".repeat(80)}.ply`],
])("%j is saved as %j", (name, expected) => expect(fileName(name, "scene", "ply")).toBe(expected));
