import { expect, test } from "vitest";

import { PlyError, readPly } from "./ply";

const NAMES = ["x", "y", "opacity"];

function file(rows: number[][], header = ""): Uint8Array {
  const head =
    header ||
    `ply\nformat binary_little_endian 1.0\nelement vertex ${rows.length}\n${NAMES.map((n) => `property float ${n}\n`).join("")}end_header\n`;
  const body = new Uint8Array(new Float32Array(rows.flat()).buffer);
  return new Uint8Array([...new TextEncoder().encode(head), ...body]);
}

async function* pieces(data: Uint8Array, size: number): AsyncGenerator<Uint8Array> {
  for (let at = 0; at < data.length; at += size) yield await Promise.resolve(data.subarray(at, at + size));
}

const ROWS = [
  [1, 2, 3],
  [4, 5, 6],
  [7, 8, 9],
];

test.each([1, 5, 64, 10_000])("rows keep their order in pieces of %d bytes", async (size) => {
  const shares: number[] = [];
  const { count, columns } = await readPly(pieces(file(ROWS), size), (share) => shares.push(share));
  expect(count).toBe(3);
  expect([...(columns.get("x") ?? [])]).toEqual([1, 4, 7]);
  expect([...(columns.get("opacity") ?? [])]).toEqual([3, 6, 9]);
  expect(shares.at(-1)).toBe(1);
  expect([...shares].sort((a, b) => a - b)).toEqual(shares);
});

test("a file of no Gaussians is read", async () => {
  expect((await readPly(pieces(file([]), 7), () => undefined)).count).toBe(0);
});

test.each([
  ["cut", file(ROWS).subarray(0, -1)],
  ["cut in its header", file(ROWS).subarray(0, 20)],
  ["empty", new Uint8Array()],
  ["something else", new TextEncoder().encode("<!doctype html>".repeat(4))],
  ["ascii", file([], "ply\nformat ascii 1.0\nelement vertex 0\nend_header\n")],
  ["of faces", file([], "ply\nformat binary_little_endian 1.0\nelement face 1\nend_header\n")],
  ["of doubles", file([], "ply\nformat binary_little_endian 1.0\nelement vertex 0\nproperty double x\nend_header\n")],
])("a file that is %s is refused", async (_, data) => {
  await expect(readPly(pieces(data, 9), () => undefined)).rejects.toThrow(PlyError);
});
