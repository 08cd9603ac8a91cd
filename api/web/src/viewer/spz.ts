/** Gaussians by column, in the file's row order: row number = Gaussian id. Names and values are those of 3DGS PLY files. */
export interface SplatColumns {
  count: number;
  columns: Map<string, Float32Array>;
}

/** A file that is no whole SPZ of version 3. */
export class SpzError extends Error {}

const HEADER = 16;
const MAGIC = 0x5053474e; // "NGSP"
const VERSION = 3;
const COLOR_SCALE = 0.15;
const HARMONICS = [0, 3, 8, 15];
/** What a half turn about x, from the axes of SPZ to those of PLY files, does to each harmonic from degree 1 on. */
const SIGNS = [-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1];
const LEAST_ALPHA = 1 / 1024;

interface Layout {
  count: number;
  bits: number;
  higher: number;
  bytes: number;
}

/**
 * Reads an SPZ file while it arrives: Niantic's format, a gzip stream of fixed-point columns.
 *
 * @param file the file's bytes.
 * @param progress called with the share read, 0..1.
 * @throws SpzError another kind of file, or one that ends too early.
 */
export async function readSpz(
  file: ReadableStream<Uint8Array<ArrayBuffer>>,
  progress: (share: number) => void,
): Promise<SplatColumns> {
  const reader = file.pipeThrough(new DecompressionStream("gzip")).getReader();
  let content = new Uint8Array(HEADER);
  let layout: Layout | null = null;
  let filled = 0;
  for (;;) {
    const { done, value } = await reader.read().catch((error: unknown) => {
      throw error instanceof DOMException ? error : new SpzError("the file is damaged or broke off");
    });
    if (done) break;
    let piece: Uint8Array = value;
    while (piece.length > 0) {
      const part = piece.subarray(0, content.length - filled);
      if (part.length === 0) throw new SpzError("the file goes on behind its Gaussians");
      content.set(part, filled);
      filled += part.length;
      piece = piece.subarray(part.length);
      if (!layout && filled === HEADER) {
        layout = layoutOf(content);
        const all = new Uint8Array(layout.bytes);
        all.set(content);
        content = all;
      }
    }
    if (layout) progress(filled / content.length);
  }
  if (!layout || filled < content.length) throw new SpzError("the file ends too early");
  return columnsOf(content, layout);
}

function layoutOf(head: Uint8Array<ArrayBuffer>): Layout {
  const view = new DataView(head.buffer);
  if (view.getUint32(0, true) !== MAGIC) throw new SpzError("not an SPZ file");
  if (view.getUint32(4, true) !== VERSION) throw new SpzError(`an SPZ file of version ${view.getUint32(4, true)}`);
  const count = view.getUint32(8, true);
  const higher = HARMONICS[view.getUint8(12)];
  const bits = view.getUint8(13);
  if (higher === undefined || bits > 23) throw new SpzError("an SPZ file with a header that makes no sense");
  return { count, bits, higher, bytes: HEADER + count * (20 + 3 * higher) };
}

function columnsOf(content: Uint8Array<ArrayBuffer>, { count, bits, higher }: Layout): SplatColumns {
  const columns = new Map<string, Float32Array>();
  let at = HEADER;
  /** Makes `names.length` columns of the bytes of `width` values a row; `value` has the place of a row's first byte. */
  const fill = (names: string[], width: number, value: (place: number, column: number) => number) => {
    names.forEach((name, column) => {
      const data = new Float32Array(count);
      for (let row = 0, place = at; row < count; row++, place += width) data[row] = value(place, column);
      columns.set(name, data);
    });
    at += count * width;
  };
  const byte = (place: number): number => content[place] ?? 0;
  const step = 2 ** -bits;
  fill(["x", "y", "z"], 9, (place, column) => {
    const low = place + 3 * column;
    const fixed = ((byte(low) << 8) | (byte(low + 1) << 16) | (byte(low + 2) << 24)) >> 8;
    return (column === 0 ? fixed : -fixed) * step;
  });
  fill(["opacity"], 1, (place) => {
    const alpha = Math.min(1 - LEAST_ALPHA, Math.max(LEAST_ALPHA, byte(place) / 255));
    return Math.log(alpha / (1 - alpha)); // finite, also where the byte is 0 or 255
  });
  fill(numbered("f_dc", 3), 3, (place, column) => (byte(place + column) / 255 - 0.5) / COLOR_SCALE);
  fill(numbered("scale", 3), 3, (place, column) => byte(place + column) / 16 - 10);
  const rotations = smallestThree(content, at, count);
  rotations.forEach((data, column) => columns.set(`rot_${column}`, data));
  at += 4 * count;
  fill(numbered("f_rest", 3 * higher), 3 * higher, (place, column) => {
    const [channel, harmonic] = [Math.floor(column / higher), column % higher]; // PLY files have one channel after another
    return ((byte(place + 3 * harmonic + channel) - 128) / 128) * (SIGNS[harmonic] ?? 1);
  });
  return { count, columns };
}

/** w, x, y and z of rotations: the place of the largest component in two bits, the others as a sign and nine bits each. */
function smallestThree(content: Uint8Array<ArrayBuffer>, at: number, count: number): Float32Array[] {
  const view = new DataView(content.buffer);
  const columns = [0, 1, 2, 3].map(() => new Float32Array(count));
  const xyzw = [0, 0, 0, 0];
  for (let row = 0; row < count; row++) {
    let word = view.getUint32(at + 4 * row, true);
    const largest = word >>> 30;
    let rest = 1;
    for (let place = 3; place >= 0; place--) {
      if (place === largest) continue;
      const magnitude = ((word & 511) / 511) * Math.SQRT1_2;
      xyzw[place] = word & 512 ? -magnitude : magnitude;
      rest -= magnitude * magnitude;
      word >>>= 10;
    }
    xyzw[largest] = Math.sqrt(Math.max(0, rest));
    const [x = 0, y = 0, z = 0, w = 0] = xyzw;
    [w, x, -y, -z].forEach((value, column) => {
      const data = columns[column];
      if (data) data[row] = value;
    });
  }
  return columns;
}

const numbered = (name: string, count: number): string[] => Array.from({ length: count }, (_, n) => `${name}_${n}`);
