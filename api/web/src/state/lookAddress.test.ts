import { describe, expect, test } from "vitest";

import { lookText, parseLook } from "./lookAddress";

describe("the look in the address", () => {
  test.each([
    { mode: "photo", cameras: false, photo: "" },
    { mode: "depth", cameras: true, photo: "" },
    { mode: "photo", cameras: false, photo: "photos/~at:cameras~objects & ü.jpg" },
    { mode: "objects", cameras: true, photo: "000.jpg" },
  ] as const)("comes back: %o", (look) => {
    expect(parseLook(lookText(look))).toEqual(look);
  });

  test("what is unknown is left out", () => {
    expect(parseLook("heat~<b>")).toEqual({ mode: "photo", cameras: false, photo: "" });
    expect(lookText({ mode: "photo", cameras: false, photo: "" })).toBe("");
  });
});
