import type { PosedCamera } from "../api/types";
import type { Sightings } from "./seenField";
import type { FromWorker, SplatFor } from "./splatWorker";
import type { SplatColumns } from "./spz";

/** A scene's Gaussians, and what its photos saw of them. */
export interface SeenSplat {
  splat: SplatColumns;
  seen: Sightings;
}

/** The file is no splat that the page can read, or ends too early. */
class SplatFileError extends Error {}

/**
 * Reads a scene's file in a worker, so that the page answers meanwhile.
 *
 * @param draws whether the Gaussians are to be drawn; else there are none, only what was seen of them.
 * @param progress called with the share read, 0..1.
 * @throws SplatFileError no splat that the page can read, or one that ends too early.
 */
export async function readSplat(
  body: ReadableStream<Uint8Array<ArrayBuffer>>,
  cameras: readonly PosedCamera[],
  draws: boolean,
  progress: (share: number) => void,
  signal: AbortSignal,
): Promise<SeenSplat> {
  const worker = new Worker(new URL("./splatWorker.ts", import.meta.url), { type: "module" });
  try {
    const read = new Promise<SeenSplat>((resolve, reject) => {
      worker.addEventListener("message", ({ data }: MessageEvent<FromWorker>) => {
        if ("share" in data) progress(data.share);
        else if ("problem" in data) reject(new SplatFileError(data.problem));
        else resolve({ splat: { count: data.count, columns: new Map(data.columns) }, seen: data.seen });
      });
      worker.addEventListener("error", (event) => reject(new SplatFileError(event.message)));
      signal.addEventListener("abort", () => reject(new DOMException("given up", "AbortError")));
    });
    read.catch(() => undefined); // said below; the body may fail first
    worker.postMessage({ cameras, draws } satisfies SplatFor);
    const reader = body.getReader();
    for (;;) {
      const { done, value } = await reader.read();
      if (done) break;
      worker.postMessage(value, [value.buffer]);
    }
    worker.postMessage(null);
    return await read;
  } finally {
    worker.terminate();
  }
}
