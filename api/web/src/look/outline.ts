import type { Segmentation } from "../api/types";

/** The mask of COCO's compressed run lengths, row by row: 1 inside, 0 outside; an Error if they do not fill it. */
export function decodeRle({ counts, size }: Segmentation): { width: number; height: number; mask: Uint8Array } {
  const [height = 0, width = 0] = size;
  const mask = new Uint8Array(width * height);
  const runs: number[] = [];
  let [place, value] = [0, 0];
  for (let at = 0; at < counts.length;) {
    let [run, shift, code] = [0, 0, 0];
    do {
      code = counts.charCodeAt(at++) - 48;
      run |= (code & 0x1f) << shift;
      shift += 5;
    } while (code & 0x20);
    if (code & 0x10) run |= -1 << shift;
    if (runs.length > 2) run += runs[runs.length - 2] ?? 0;
    runs.push(run);
    // Down the columns.
    for (let end = place + run; place < end; place++)
      if (value) mask[(place % height) * width + Math.floor(place / height)] = 1;
    value = 1 - value;
  }
  if (place !== width * height) throw new Error("run lengths that do not fill the mask");
  return { width, height, mask };
}

/** Red, green, blue and alpha of a picture that veils a mask's inside lightly and marks its edge. */
export function outlinePixels(
  { width, height, mask }: { width: number; height: number; mask: Uint8Array },
  [red, green, blue]: readonly [number, number, number],
): Uint8ClampedArray<ArrayBuffer> {
  const pixels = new Uint8ClampedArray(width * height * 4);
  const inside = (x: number, y: number) => x >= 0 && y >= 0 && x < width && y < height && mask[y * width + x] === 1;
  for (let y = 0; y < height; y++)
    for (let x = 0; x < width; x++) {
      if (!inside(x, y)) continue;
      const edge = [-2, -1, 1, 2].some((step) => !inside(x + step, y) || !inside(x, y + step));
      pixels.set([red, green, blue, edge ? 255 : 40], (y * width + x) * 4);
    }
  return pixels;
}

/** Left, top and side of the square around a mask's inside, with some of what is around it. */
export function cropAround({ width, mask }: { width: number; mask: Uint8Array }): readonly [number, number, number] {
  let [left, right, top, bottom] = [width, 0, mask.length / width, 0];
  mask.forEach((inside, at) => {
    if (!inside) return;
    const [x, y] = [at % width, Math.floor(at / width)];
    [left, right, top, bottom] = [Math.min(left, x), Math.max(right, x), Math.min(top, y), Math.max(bottom, y)];
  });
  const side = 1.25 * (Math.max(right - left, bottom - top, 0) + 1);
  return [(left + right + 1 - side) / 2, (top + bottom + 1 - side) / 2, side];
}
