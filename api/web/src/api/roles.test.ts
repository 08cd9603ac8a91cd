import { expect, test } from "vitest";

import { mayDo, rolesUpTo } from "./roles";

test("a role may do what those before it may", () => {
  expect(mayDo("reader", "reader")).toBe(true);
  expect(mayDo("reader", "editor")).toBe(false);
  expect(mayDo("operator", "admin")).toBe(true);
  expect(mayDo("uploader", "reader")).toBe(false);
  expect(mayDo("suggester", "reader")).toBe(false);
});

test("nobody makes a key of a higher role", () => {
  expect(rolesUpTo("admin")).toEqual(["suggester", "reader", "editor", "admin"]);
  expect(rolesUpTo("operator")).toContain("operator");
});
