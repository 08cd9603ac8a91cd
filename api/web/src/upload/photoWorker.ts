import type { PhotoQuality } from "./photoQuality";
import { MEASURED_SIDE, measured } from "./photoQuality";

/** Looks at photos beside the page, one after the other, and sends of each a small picture and its measures. */

export interface ToWorker {
  number: number;
  file: File;
}

/** `seen` is null where the browser cannot read the file. */
export interface FromWorker {
  number: number;
  seen: { picture: Blob; quality: PhotoQuality; width: number; height: number } | null;
}

const SHOWN_SIDE = 240;
let before: Promise<void> = Promise.resolve();

addEventListener("message", ({ data }: MessageEvent<ToWorker>) => {
  before = before.then(async () => {
    const seen = await look(data.file).catch(() => null);
    postMessage({ number: data.number, seen } satisfies FromWorker);
  });
});

async function look(file: File): Promise<FromWorker["seen"]> {
  const bitmap = await createImageBitmap(file);
  try {
    const { width, height } = bitmap;
    const large = drawn(bitmap, MEASURED_SIDE);
    const pixels = large.getContext("2d")?.getImageData(0, 0, large.width, large.height);
    if (!pixels) return null;
    const picture = await drawn(large, SHOWN_SIDE).convertToBlob({ type: "image/jpeg", quality: 0.8 });
    return { picture, quality: measured(pixels.data, large.width, large.height), width, height };
  } finally {
    bitmap.close();
  }
}

function drawn(source: ImageBitmap | OffscreenCanvas, side: number): OffscreenCanvas {
  const ratio = Math.min(1, side / Math.max(source.width, source.height));
  const [width, height] = [source.width, source.height].map((length) => Math.max(1, Math.round(length * ratio)));
  const canvas = new OffscreenCanvas(width ?? 1, height ?? 1);
  const context = canvas.getContext("2d", { willReadFrequently: true });
  if (context) context.imageSmoothingQuality = "high";
  context?.drawImage(source, 0, 0, canvas.width, canvas.height);
  return canvas;
}
