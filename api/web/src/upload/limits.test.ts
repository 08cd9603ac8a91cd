import { expect, test } from "vitest";

import type { ServerStatus } from "../api/types";
import { limitsOf, refusalOf } from "./limits";

const status = (used: number, limit: number | null, role: ServerStatus["role"] = "editor") =>
  ({
    role,
    max_upload_bytes: 500,
    max_images: 7,
    quotas: [
      { kind: "scenes", used: 0, limit: 3 },
      { kind: "bytes", used, limit },
    ],
  }) as unknown as ServerStatus;

test("what is left is the quota less what is used", () => {
  expect(limitsOf(status(40, 100))).toEqual({ maxBytes: 500, bytesLeft: 60, maxImages: 7 });
  expect(limitsOf(status(140, 100)).bytesLeft).toBe(0);
  expect(limitsOf(status(40, null)).bytesLeft).toBeNull();
});

test("a full quota, and a key that only looks, are said", () => {
  expect(refusalOf(status(40, 100))).toBe("");
  expect(refusalOf(status(40, null))).toBe("");
  expect(refusalOf(status(100, 100))).toContain("full");
  expect(refusalOf(status(40, 100, "reader"))).not.toBe("");
  expect(refusalOf(status(40, 100, "uploader"))).toBe("");
});
