import { describe, expect, test } from "vitest";

import type { PosedCamera, SceneThing } from "../api/types";
import { axesOf, cameraOf, orbit, rayOf } from "../viewer/poses";
import type { Vec } from "../viewer/vectors";
import { cross, dot, length, scale, subtract, unit } from "../viewer/vectors";
import { coloringByLabel, coloringByThing, colorOf, NOTHING, tintsOf } from "./colors";
import { lookText, parseLook } from "./lookAddress";
import { decodeRle, outlinePixels } from "./outline";
import { frustumOf, photoRect, Projection, viewOfPhoto } from "./projection";

const SIZE = { width: 700, height: 500 };

/** A phone's camera that was held askew, its principal point off the middle, its pixels not square. */
function askew(): PosedCamera {
  const looking = cameraOf({ position: [1, -3, 1.5], target: [0.2, 0.1, 0.3], up: unit([0.3, 0.1, 1]) }, 640, 480);
  return { ...looking, name: "a", intrinsics: { width: 640, height: 480, fx: 520, fy: 500, cx: 300, cy: 260 } };
}

function pixelIn(camera: PosedCamera, point: Vec): readonly [number, number] {
  const { position, forward, up } = rayOf(camera);
  const offset = subtract(point, position);
  const { fx, fy, cx, cy } = camera.intrinsics;
  const depth = dot(offset, forward);
  return [cx + (fx * dot(offset, cross(forward, up))) / depth, cy - (fy * dot(offset, up)) / depth];
}

describe("standing at a photo", () => {
  test.each([SIZE, { width: 390, height: 500 }, { width: 1200, height: 300 }])(
    "photo and scene show each point at the same place in %o",
    (size) => {
      const camera = askew();
      const view = viewOfPhoto(camera, 3, [0, 0, 1], size);
      const rect = photoRect(camera, view, size);
      const projection = new Projection(view, size);
      for (const point of [
        [0, 0, 0],
        [0.5, 0.4, 0.2],
        [-0.6, 0.1, 0.9],
      ] as const) {
        const [u, v] = pixelIn(camera, point);
        const [[x, y]] = projection.line(point, point) ?? [[NaN, NaN]];
        expect(rect.left + (u / 640) * rect.width).toBeCloseTo(x, 6);
        expect(rect.top + (v / 480) * rect.height).toBeCloseTo(y, 6);
      }
    },
  );

  test("the whole photo is in the picture, and touches its edge", () => {
    for (const size of [SIZE, { width: 390, height: 500 }]) {
      const rect = photoRect(askew(), viewOfPhoto(askew(), 3, [0, 0, 1], size), size);
      const room = [rect.left, rect.top, size.width - rect.left - rect.width, size.height - rect.top - rect.height];
      expect(Math.min(...room)).toBeCloseTo(0, 6);
    }
  });

  test("the view keeps the photo's tilt, and the scene is level again once it is orbited", () => {
    const view = viewOfPhoto(askew(), 3, [0, 0, 1], SIZE);
    const { up } = rayOf(askew());
    expect(length(subtract(scale(axesOf(view).down, -1), up))).toBeLessThan(1e-9);
    expect(orbit(view, 0.1, 0).up).toEqual([0, 0, 1]);
  });
});

test("a camera is drawn from its position to the corners of its picture", () => {
  const { apex, corners } = frustumOf(askew(), 0.5);
  expect(apex).toEqual([1, -3, 1.5]);
  const pixels = corners.map((corner) => pixelIn(askew(), corner));
  const expected = [
    [0, 0],
    [640, 0],
    [640, 480],
    [0, 480],
  ];
  pixels.forEach(([u, v], index) => {
    expect(u).toBeCloseTo(expected[index]?.[0] ?? NaN, 6);
    expect(v).toBeCloseTo(expected[index]?.[1] ?? NaN, 6);
  });
});

test("what is behind the viewer is not drawn, and a line is cut where it comes in front", () => {
  const view = { position: [0, 0, 0], target: [0, 1, 0], up: [0, 0, 1] } as const;
  const projection = new Projection(view, SIZE);
  expect(projection.line([0, -1, 0], [1, -2, 0])).toBeNull();
  const [from, to] = projection.line([0, -1, 0], [0, 2, 0]) ?? [[], []];
  expect([...from, ...to]).toEqual([350, 250, 350, 250]);
});

describe("the look in the address", () => {
  test.each([
    { mode: "photo", cameras: false, photo: "" },
    { mode: "depth", cameras: true, photo: "" },
    { mode: "photo", cameras: false, photo: "photos/~at:cameras~things & ü.jpg" },
    { mode: "things", cameras: true, photo: "000.jpg" },
  ] as const)("comes back: %o", (look) => {
    expect(parseLook(lookText(look))).toEqual(look);
  });

  test("what is unknown is left out", () => {
    expect(parseLook("heat~<b>")).toEqual({ mode: "photo", cameras: false, photo: "" });
    expect(lookText({ mode: "photo", cameras: false, photo: "" })).toBe("");
  });
});

describe("colors", () => {
  const things = ["mug", "", "mug", "ball"].map((name, index) => ({ id: index + 1, name }) as SceneThing);

  test("differ from number to number", () => {
    const all = Array.from({ length: 24 }, (_, index) => colorOf(index + 1));
    for (const [index, color] of all.entries())
      for (const other of all.slice(index + 1)) expect(length(subtract(color, other))).toBeGreaterThan(12);
  });

  test("things of one name have one color as labels, and each its own as things", () => {
    const { byThing, legend } = coloringByLabel(things);
    expect(legend.map((entry) => entry.name)).toEqual(["ball", "mug"]);
    expect(byThing.get(1)).toEqual(byThing.get(3));
    expect(byThing.has(2)).toBe(false);
    expect(new Set(coloringByThing(things, String).byThing.values()).size).toBe(4);
  });

  test("are each Gaussian's, by row", () => {
    const tints = tintsOf(new Uint16Array([0, 2, 9]), new Map([[2, [1, 2, 3] as const]]));
    expect([...tints]).toEqual([...NOTHING, 255, 1, 2, 3, 255, ...NOTHING, 255]);
  });
});

describe("a mask's outline", () => {
  // What the service sends of a 4 × 5 picture (height × width) whose pixels (1..2, 1..3) are set.
  const segmentation = { size: [4, 5], counts: "5220003" };

  test("run lengths down the columns are pixels", () => {
    const { width, height, mask } = decodeRle(segmentation);
    expect([width, height]).toEqual([5, 4]);
    expect([...mask]).toEqual([0, 0, 0, 0, 0, 0, 1, 1, 1, 0, 0, 1, 1, 1, 0, 0, 0, 0, 0, 0]);
    expect(() => decodeRle({ ...segmentation, size: [4, 4] })).toThrow();
  });

  test("the edge is solid, the inside a veil, the rest clear", () => {
    const mask = new Uint8Array(81).fill(1);
    const pixels = outlinePixels({ width: 9, height: 9, mask }, [9, 8, 7]);
    expect([...pixels.slice(0, 4)]).toEqual([9, 8, 7, 255]);
    expect([...pixels.slice(40 * 4, 41 * 4)]).toEqual([9, 8, 7, 40]);
    expect(outlinePixels({ width: 1, height: 1, mask: new Uint8Array(1) }, [9, 8, 7])[3]).toBe(0);
  });
});
