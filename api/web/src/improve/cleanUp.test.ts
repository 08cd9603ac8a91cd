import { expect, test } from "vitest";

import type { Vec } from "../viewer/vectors";
import { cross, unit } from "../viewer/vectors";
import type { CropBox } from "./cleanUp";
import { edgesOf, editsOf, NOTHING, quaternionOf } from "./cleanUp";

const BOX: CropBox = {
  origin: [1, 2, 3],
  axes: [
    [0, 1, 0],
    [-1, 0, 0],
    [0, 0, 1],
  ],
  low: [-1, -2, 0],
  high: [3, 2, 4],
};

test("each control is an edit of its own, and none is sent where nothing is to go", () => {
  expect(editsOf(NOTHING)).toEqual([]);
  expect(editsOf({ ...NOTHING, opacity: 0.1, isolation: 3, objects: [4, 7] })).toEqual([
    { action: "remove", object_ids: [4, 7] },
    { action: "remove", filter: { opacity_below: 0.1, outside: false } },
    { action: "remove", filter: { isolation_above: 3, outside: false } },
  ]);
});

test("a box is sent by its middle, its turn and its size", () => {
  const [edit] = editsOf({ ...NOTHING, box: BOX });
  const half = Math.SQRT1_2; // a quarter turn about z
  expect(edit?.filter?.outside).toBe(true);
  expect(edit?.filter?.box?.size).toEqual({ x: 4, y: 4, z: 4 });
  expect(edit?.filter?.box?.center.position).toEqual({ x: 1, y: 3, z: 5 });
  const { x, y, z, w } = edit?.filter?.box?.center.orientation ?? { x: 1, y: 1, z: 1, w: 1 };
  for (const [value, wanted] of [
    [x, 0],
    [y, 0],
    [z, half],
    [w, half],
  ] as const)
    expect(value).toBeCloseTo(wanted);
});

test("a box has twelve edges, each along an axis and as long as the box there", () => {
  const lengths = edgesOf(BOX).map(([from, to]) => Math.hypot(...to.map((value, axis) => value - (from[axis] ?? 0))));
  expect(lengths).toEqual(Array.from({ length: 12 }, () => 4));
  expect(new Set(edgesOf(BOX).map((edge) => JSON.stringify(edge))).size).toBe(12);
});

test("the quaternion of three axes turns the world's axes into them", () => {
  const turned = ({ x, y, z, w }: ReturnType<typeof quaternionOf>, v: Vec): Vec => {
    const axis: Vec = [x, y, z];
    const twice = cross(axis, v).map((value) => 2 * value) as unknown as Vec;
    const more = cross(axis, twice);
    return [v[0] + w * twice[0] + more[0], v[1] + w * twice[1] + more[1], v[2] + w * twice[2] + more[2]];
  };
  for (const up of [
    [0, 0, 1],
    [0, 0, -1],
    [0, 1, 0],
    [-1, 0, 0],
    [0.3, -0.8, 0.5],
  ] as const) {
    const third = unit(up);
    const first = unit(cross(Math.abs(third[1]) < 0.9 ? [0, 1, 0] : [1, 0, 0], third));
    const axes = [first, cross(third, first), third] as const;
    const quaternion = quaternionOf(axes);
    for (const [number, axis] of axes.entries()) {
      const own = turned(quaternion, [+(number === 0), +(number === 1), +(number === 2)]);
      for (const at of [0, 1, 2] as const) expect(own[at]).toBeCloseTo(axis[at]);
    }
  }
});
