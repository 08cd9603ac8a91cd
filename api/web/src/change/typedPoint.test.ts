import { expect, test } from "vitest";

import { texts } from "../texts";
import { parsePoint } from "./typedPoint";

test("a typed point is three numbers", () => {
  expect(parsePoint("0.5, -1 2e-1")?.point).toEqual({ x: 0.5, y: -1, z: 0.2 });
  for (const text of ["", "1, 2", "1 2 3 4", "1, , 2", "a b c", "1 2 Infinity"]) expect(parsePoint(text)).toBeNull();
});

test("a length says its interval and its unit, meters only where they are known", () => {
  expect(texts.change.length({ value: 1.2345, low: 1.2, high: 1.269 }, true)).toBe("1.234 m ± 0.034 m");
  expect(texts.change.length({ value: 0.05, low: 0.04, high: 0.06 }, true)).toBe("0.050 m ± 0.010 m");
  expect(texts.change.length({ value: 2, low: 2, high: 2 }, false)).toBe("2.000 scene units ± 0.000");
});
