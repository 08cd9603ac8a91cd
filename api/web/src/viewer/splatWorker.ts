import type { PosedCamera } from "../api/types";
import { fewerBands } from "./harmonics";
import type { Sightings } from "./seenField";
import { sightingsOf } from "./seenField";
import { readSpz } from "./spz";

/** Reads a scene's file beside the page and finds what its photos saw; receives `SplatFor`, the pieces, null. */

/** The scene's cameras, and whether its Gaussians are to be drawn. */
export interface SplatFor {
  cameras: readonly PosedCamera[];
  draws: boolean;
}

export type FromWorker =
  | { share: number }
  | { count: number; columns: [string, Float32Array<ArrayBuffer>][]; seen: Sightings }
  | { problem: string };

const pieces = new TransformStream<Uint8Array<ArrayBuffer>, Uint8Array<ArrayBuffer>>();
const writer = pieces.writable.getWriter();
let purpose: SplatFor = { cameras: [], draws: true };

addEventListener("message", ({ data }: MessageEvent<SplatFor | Uint8Array<ArrayBuffer> | null>) => {
  if (data && !(data instanceof Uint8Array)) purpose = data;
  else (data ? writer.write(data) : writer.close()).catch(() => undefined); // the reader says what is wrong
});

const tell = (message: FromWorker, transfer: Transferable[] = []) => postMessage(message, { transfer });

readSpz(pieces.readable, (share) => tell({ share })).then(
  (splat) => {
    const { count, columns } = fewerBands(splat);
    const seen = sightingsOf({ count, columns }, purpose.cameras);
    const all = (purpose.draws ? [...columns] : []) as [string, Float32Array<ArrayBuffer>][];
    tell(
      { count: purpose.draws ? count : 0, columns: all, seen },
      all.map(([, data]) => data.buffer),
    );
  },
  (error: unknown) => tell({ problem: error instanceof Error ? error.message : String(error) }),
);
