import type { SceneObject } from "../api/types";

/** What the Gaussians' colors say. */
export const MODES = ["photo", "depth", "normals", "labels", "objects"] as const;
export type Mode = (typeof MODES)[number];

type Rgb = readonly [number, number, number];

/** Depth from near to far, bytes. */
export const DEPTH_STOPS: readonly Rgb[] = [
  [253, 231, 37],
  [94, 201, 98],
  [33, 145, 140],
  [59, 82, 139],
  [68, 1, 84],
];

/** Of normals along the scene's axes. */
export const AXES: readonly Rgb[] = [
  [255, 128, 128],
  [128, 255, 128],
  [128, 128, 255],
];

/** Of what belongs to nothing. */
export const NOTHING: Rgb = [120, 124, 128];

const GOLDEN = 0.6180339887498949; // hues that follow each other lie far apart, however many there are

/** The color of a number from 1, bytes. */
export function colorOf(number: number): Rgb {
  const hue = ((number * GOLDEN) % 1) * 6;
  const value = number % 3 === 0 ? 205 : 250;
  const low = value * 0.28;
  const rise = low + (value - low) * (hue % 1);
  const fall = low + (value - low) * (1 - (hue % 1));
  const channels: readonly Rgb[] = [
    [value, rise, low],
    [fall, value, low],
    [low, value, rise],
    [low, fall, value],
    [rise, low, value],
    [value, low, fall],
  ];
  const [r, g, b] = channels[Math.floor(hue)] ?? NOTHING;
  return [Math.round(r), Math.round(g), Math.round(b)];
}

/** A line of the legend. */
export interface LegendEntry {
  name: string;
  color: Rgb;
}

/** Colors by object id, and what they mean: one an object, or one a name. */
interface Coloring {
  byObject: Map<number, Rgb>;
  legend: LegendEntry[];
}

/** A color for each object. */
export function coloringByObject(objects: readonly SceneObject[], titleOf: (object: SceneObject) => string): Coloring {
  const byObject = new Map(objects.map((object) => [object.id, colorOf(object.id)]));
  return { byObject, legend: objects.map((object) => ({ name: titleOf(object), color: colorOf(object.id) })) };
}

/** A color for each label: the objects of one name have one. Those without a name have none. */
export function coloringByLabel(objects: readonly SceneObject[]): Coloring {
  const names = [...new Set(objects.map((object) => object.name).filter(Boolean))].sort();
  const colors = new Map(names.map((name, index) => [name, colorOf(index + 1)]));
  const byObject = new Map<number, Rgb>();
  for (const object of objects) {
    const color = colors.get(object.name);
    if (color) byObject.set(object.id, color);
  }
  return { byObject, legend: [...colors].map(([name, color]) => ({ name, color })) };
}

/** Red, green, blue and 255 of each Gaussian, by the object it belongs to. */
export function tintsOf(owners: Uint16Array, byObject: ReadonlyMap<number, Rgb>): Uint8Array {
  const packed = new Uint32Array(0x10000).fill(word(NOTHING));
  for (const [id, color] of byObject) packed[id] = word(color);
  const tints = new Uint32Array(owners.length);
  for (let row = 0; row < owners.length; row++) tints[row] = packed[owners[row] ?? 0] ?? 0;
  return new Uint8Array(tints.buffer);
}

function word([red, green, blue]: Rgb): number {
  const bytes = new Uint8Array([red, green, blue, 255]);
  return new Uint32Array(bytes.buffer)[0] ?? 0;
}

export function css([red, green, blue]: Rgb): string {
  return `rgb(${red}, ${green}, ${blue})`;
}
