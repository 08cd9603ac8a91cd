import { expect, test } from "vitest";

import type { SceneVersion } from "../api/types";
import { geometryVersion } from "./versions";

const version = (name: string, parent: string, ...actions: string[]): SceneVersion =>
  ({ version: name, parent, edits: actions.map((action) => ({ action })) }) as SceneVersion;

test("names leave the splat as it is, other edits do not", () => {
  const versions = [
    version("a", ""),
    version("b", "a", "name"),
    version("c", "b", "merge", "discard"),
    version("d", "c", "name", "remove"),
    version("e", "d", "unname"),
  ];
  expect(["a", "b", "c", "d", "e", "?"].map((each) => geometryVersion(versions, each))).toEqual([
    "a",
    "a",
    "a",
    "d",
    "d",
    "?",
  ]);
});
