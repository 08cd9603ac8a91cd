import { expect, test } from "vitest";

import { parseRoute, sceneAddress, shareKeyIn } from "./addresses";

test.each(["", "#", "#content"])("%j is the list", (hash) => expect(parseRoute(hash)).toEqual({ page: "scenes" }));

test("a scene's address comes back", () => {
  const more = {
    text: "where is the “mug” & ü?",
    version: "v/2",
    view: "1_2_3_4_5_6",
    objects: [3, 14],
    look: "depth~at:a & b",
  };
  expect(parseRoute(sceneAddress("a/b?c#d", more))).toEqual({ page: "scene", sceneId: "a/b?c#d", ...more });
  expect(sceneAddress("abc")).toBe("#/scenes/abc");
});

test.each(["#/scenes/a?objects=", "#/scenes/a?objects=x,-1,0,1.5", "#/scenes/a"])("%j selects nothing", (hash) =>
  expect(parseRoute(hash)).toMatchObject({ objects: [] }),
);

test.each(["#/scenes/", "#/scenes/a/b", "#/elsewhere"])("%j leads nowhere", (hash) =>
  expect(parseRoute(hash)).toEqual({ page: "unknown" }),
);

test("a broken escape is taken as it is", () => expect(parseRoute("#/scenes/%zz")).toMatchObject({ sceneId: "%zz" }));

test("a link's key is in its address", () => {
  const address = sceneAddress("a", { text: "a?share=b", share: "fsk_1" });
  expect(shareKeyIn(address)).toBe("fsk_1");
  expect(parseRoute(address)).toMatchObject({ sceneId: "a", text: "a?share=b" });
  expect(["", "#/", "#/scenes/a", sceneAddress("a", { text: "share=x" })].map(shareKeyIn)).toEqual(["", "", "", ""]);
});
