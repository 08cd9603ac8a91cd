import { beforeAll, expect, test, vi } from "vitest";

let link: typeof import("./uploadLink");
beforeAll(async () => {
  vi.stubGlobal("sessionStorage", { getItem: () => null });
  link = await import("./uploadLink");
});

test("the key stands behind the #", () => {
  expect(link.linkFor("http://192.168.1.20:8000/", "fsk_1_a")).toBe("http://192.168.1.20:8000/#/phone?key=fsk_1_a");
  expect(link.linkFor("https://a.example/splat/?x=1#/new", "k")).toBe("https://a.example/splat/#/phone?key=k");
  expect(new URL(link.linkFor("http://a.example", "k")).search).toBe("");
});

test.each([
  ["localhost", true],
  ["127.0.0.1", true],
  ["[::1]", true],
  ["192.168.1.20", false],
  ["splat.example", false],
])("%s is this machine alone: %s", (host, loopback) => expect(link.isLoopback(host)).toBe(loopback));
