import { send } from "../api/http";

const KEEP_MS = 60_000;

/** A file's name, or what makes it of the ending that the server gives the file. */
export type FileNaming = string | ((ending: string) => string);

/**
 * Saves a file that needs the key, which a link could not send; the browser keeps a large blob on disk.
 *
 * @param progress called with the bytes that have come and those of the whole file, 0 while that is unknown.
 */
export async function save(
  path: string,
  name: FileNaming,
  progress: (bytes: number, of: number) => void,
  options: Parameters<typeof send>[1] = {},
): Promise<void> {
  const response = await send(path, options);
  const encoded = response.headers.has("Content-Encoding"); // the length is then not that of what comes out
  const of = encoded ? 0 : Number(response.headers.get("Content-Length") ?? 0);
  let bytes = 0;
  const counter = new TransformStream<Uint8Array<ArrayBuffer>, Uint8Array<ArrayBuffer>>({
    transform(piece, controller) {
      bytes += piece.length;
      progress(bytes, of);
      controller.enqueue(piece);
    },
  });
  const body = response.body?.pipeThrough(counter) ?? null;
  const ending = /filename="[^."]*\.([^"]+)"/.exec(response.headers.get("Content-Disposition") ?? "")?.[1] ?? "bin";
  keep(await new Response(body).blob(), typeof name === "string" ? name : name(ending));
}

/** Saves what is here already. */
export function keep(blob: Blob, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  window.setTimeout(() => URL.revokeObjectURL(link.href), KEEP_MS);
}
