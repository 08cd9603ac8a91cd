import { gzipSync } from "node:zlib";

import { expect, test } from "vitest";

import { readSpz, SpzError } from "./spz";

// Two Gaussians with harmonics of degree 1, at (1, 2, −3) and (−1, 0, 0) of the PLY's axes.
const BITS = 12;
const fixed = (value: number): number[] => {
  const whole = Math.round(value * (1 << BITS));
  return [whole & 255, (whole >> 8) & 255, (whole >> 16) & 255];
};
const word = (value: number): number[] => [...new Uint8Array(new Uint32Array([value]).buffer)];
const CONTENT = [
  ...new TextEncoder().encode("NGSP"),
  ...word(3),
  ...word(2),
  ...[1, BITS, 0, 0],
  ...[1, -2, 3].flatMap(fixed),
  ...[-1, 0, 0].flatMap(fixed),
  ...[128, 255], // opacities
  ...[255, 0, 128, 10, 20, 30], // colors
  ...[160, 144, 0, 160, 160, 160], // scales
  ...word(3 * 2 ** 30 + (511 << 20)), // w is largest; x = √½
  ...word(3 * 2 ** 30 + (512 + 511)), // z = −√½
  ...[192, 128, 64, 0, 128, 255, 128, 128, 128],
  ...[128, 128, 128, 128, 128, 128, 128, 128, 128],
];

function pieces(data: Uint8Array, size: number): ReadableStream<Uint8Array<ArrayBuffer>> {
  return new ReadableStream({
    start(controller) {
      for (let at = 0; at < data.length; at += size) controller.enqueue(new Uint8Array(data.subarray(at, at + size)));
      controller.close();
    },
  });
}

const file = (content: number[] = CONTENT): Uint8Array => gzipSync(new Uint8Array(content));

test.each([1, 5, 10_000])("rows keep their order in pieces of %d bytes", async (size) => {
  const shares: number[] = [];
  const { count, columns } = await readSpz(pieces(file(), size), (share) => shares.push(share));
  const column = (name: string) => [...(columns.get(name) ?? [])];
  expect(count).toBe(2);
  expect([column("x"), column("y"), column("z")]).toEqual([
    [1, -1],
    [2, -0],
    [-3, -0],
  ]);
  expect(column("scale_0")).toEqual([0, 0]);
  expect(column("scale_1")).toEqual([-1, 0]);
  expect(column("f_dc_0")[0]).toBeCloseTo(0.5 / 0.15, 5);
  expect(column("opacity")[0]).toBeCloseTo(Math.log(128 / 127), 5);
  expect(column("opacity")[1]).toBeGreaterThan(6);
  // y z x of red, green and blue; y and z change their signs
  expect(["f_rest_0", "f_rest_1", "f_rest_2", "f_rest_3", "f_rest_6"].map((name) => column(name)[0])).toEqual([
    -0.5, 1, 0, -0, 0.5,
  ]);
  const [w, x, y, z] = ["rot_0", "rot_1", "rot_2", "rot_3"].map(column);
  expect(x?.[0]).toBeCloseTo(Math.SQRT1_2, 5);
  expect(w?.[0]).toBeCloseTo(Math.SQRT1_2, 5);
  expect(y?.[0]).toBeCloseTo(0);
  expect(z?.[1]).toBeCloseTo(Math.SQRT1_2, 5);
  expect(shares.at(-1)).toBe(1);
  expect([...shares].sort((a, b) => a - b)).toEqual(shares);
});

test.each([
  ["cut", file().subarray(0, -20)],
  ["too short", file(CONTENT.slice(0, -1))],
  ["too long", file([...CONTENT, 0])],
  ["empty", new Uint8Array()],
  ["no gzip", new TextEncoder().encode("<!doctype html>".repeat(4))],
  ["something else", file(CONTENT.map((byte, at) => (at === 0 ? 0 : byte)))],
  ["of version 2", file(CONTENT.map((byte, at) => (at === 4 ? 2 : byte)))],
  ["of degree 9", file(CONTENT.map((byte, at) => (at === 12 ? 9 : byte)))],
])("a file that is %s is refused", async (_, data) => {
  await expect(readSpz(pieces(data, 9), () => undefined)).rejects.toThrow(SpzError);
});
