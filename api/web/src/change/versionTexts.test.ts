import { expect, test } from "vitest";

import type { Edit, SceneVersion } from "../api/types";
import { describeVersion, lineOf } from "./versionTexts";

const edit = (values: Partial<Edit>): Edit => ({ object_ids: [], texts: [], aliases: [], ...values }) as Edit;
const version = (name: string, parent: string, ...edits: Edit[]): SceneVersion =>
  ({ version: name, parent, edits }) as SceneVersion;

test("a version says what made it", () => {
  expect(describeVersion(version("a", ""))).toBe("As it was trained");
  expect(describeVersion(version("b", "a", edit({ action: "remove", object_ids: [2] })))).toBe("Removed object 2");
  const named = edit({ action: "name", object_ids: [1, 3], name: "mug" });
  expect(describeVersion(version("b", "a", named, named))).toBe("Named objects 1, 3 “mug”");
  expect(describeVersion(version("b", "a", edit({ action: "recolor", label: "ball" })))).toBe("Recolored ball");
  expect(describeVersion(version("b", "a", edit({ action: "add" })))).toBe("Added an object");
});

test("the line of a version leads back to the first", () => {
  const versions = [version("a", ""), version("b", "a"), version("c", "a"), version("d", "c")];
  expect([...lineOf(versions, "d")]).toEqual(["d", "c", "a"]);
  expect([...lineOf(versions, "b")]).toEqual(["b", "a"]);
});
