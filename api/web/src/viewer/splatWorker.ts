import { fewerBands } from "./harmonics";
import { readSpz } from "./spz";

/** Reads a scene's file beside the page, which answers meanwhile. Pieces of the file come as messages, null at its end. */

export type FromWorker =
  { share: number } | { count: number; columns: [string, Float32Array<ArrayBuffer>][] } | { problem: string };

const pieces = new TransformStream<Uint8Array<ArrayBuffer>, Uint8Array<ArrayBuffer>>();
const writer = pieces.writable.getWriter();

addEventListener("message", ({ data }: MessageEvent<Uint8Array<ArrayBuffer> | null>) => {
  (data ? writer.write(data) : writer.close()).catch(() => undefined); // the reader says what is wrong
});

const tell = (message: FromWorker, transfer: Transferable[] = []) => postMessage(message, { transfer });

readSpz(pieces.readable, (share) => tell({ share })).then(
  (splat) => {
    const { count, columns } = fewerBands(splat);
    const all = [...columns] as [string, Float32Array<ArrayBuffer>][];
    tell(
      { count, columns: all },
      all.map(([, data]) => data.buffer),
    );
  },
  (error: unknown) => tell({ problem: error instanceof Error ? error.message : String(error) }),
);
