/** The columns of a 3DGS PLY, in the file's row order: row number = Gaussian id. */
export interface SplatColumns {
  count: number;
  columns: Map<string, Float32Array>;
}

/** A file that is no binary 3DGS PLY of floats. */
export class PlyError extends Error {}

const HEADER_END = "end_header\n";
const LONGEST_HEADER = 16_384;

interface Header {
  count: number;
  names: string[];
  bytes: number;
}

/** The header of a PLY whose first bytes are `head`, or null while it is not complete. */
export function parseHeader(head: Uint8Array): Header | null {
  const text = new TextDecoder("latin1").decode(head.subarray(0, LONGEST_HEADER));
  if (!"ply\n".startsWith(text.slice(0, 4))) throw new PlyError("not a PLY file");
  const end = text.indexOf(HEADER_END);
  if (end < 0) {
    if (head.length >= LONGEST_HEADER) throw new PlyError("a PLY header without an end");
    return null;
  }
  let count = -1;
  const names: string[] = [];
  for (const line of text.slice(0, end).split("\n").slice(1)) {
    const words = line.trim().split(/\s+/);
    if (words[0] === "format" && words[1] !== "binary_little_endian")
      throw new PlyError(`a PLY of format ${words[1] ?? ""}`);
    if (words[0] === "element") {
      if (words[1] !== "vertex" || count >= 0) throw new PlyError("a PLY with more than vertices");
      count = Number(words[2]);
    }
    if (words[0] === "property") {
      if (words[1] !== "float") throw new PlyError(`a PLY with a property of type ${words[1] ?? ""}`);
      names.push(words[2] ?? "");
    }
  }
  if (!Number.isInteger(count) || count < 0) throw new PlyError("a PLY without vertices");
  return { count, names, bytes: end + HEADER_END.length };
}

/**
 * Reads a 3DGS PLY while it arrives.
 *
 * @param chunks the file's bytes, in any pieces.
 * @param progress called with the share read, 0..1.
 * @throws PlyError another kind of file, or one that ends too early.
 */
export async function readPly(
  chunks: AsyncIterable<Uint8Array>,
  progress: (share: number) => void,
): Promise<SplatColumns> {
  let head = new Uint8Array();
  let header: Header | null = null;
  let rows = new Uint8Array();
  let filled = 0;
  for await (const chunk of chunks) {
    let piece = chunk;
    if (!header) {
      head = joined(head, chunk);
      header = parseHeader(head);
      if (!header) continue;
      rows = new Uint8Array(header.count * header.names.length * 4);
      piece = head.subarray(header.bytes);
    }
    const part = piece.subarray(0, rows.length - filled);
    rows.set(part, filled);
    filled += part.length;
    progress(rows.length ? filled / rows.length : 1);
  }
  if (!header || filled < rows.length) throw new PlyError("the file ends too early");
  return { count: header.count, columns: toColumns(rows, header) };
}

function toColumns(rows: Uint8Array, { count, names }: Header): Map<string, Float32Array> {
  const values = new Float32Array(rows.buffer);
  const width = names.length;
  return new Map(
    names.map((name, column) => {
      const data = new Float32Array(count);
      for (let row = 0, at = column; row < count; row++, at += width) data[row] = values[at] ?? 0;
      return [name, data];
    }),
  );
}

function joined(a: Uint8Array, b: Uint8Array): Uint8Array<ArrayBuffer> {
  const both = new Uint8Array(a.length + b.length);
  both.set(a);
  both.set(b, a.length);
  return both;
}

/** The pieces of a response's body. */
export async function* bodyOf(response: Response): AsyncGenerator<Uint8Array> {
  const reader = response.body?.getReader();
  if (!reader) return;
  try {
    for (;;) {
      const { done, value } = await reader.read();
      if (done) return;
      yield value;
    }
  } finally {
    reader.releaseLock();
  }
}
