import { ApiError, keyHeaders, OfflineError, refuseKey, send } from "../api/http";
import type { Problem } from "../api/types";
import type { ChosenFile } from "./choose";

const VERSION = { "Tus-Resumable": "1.0.0" };
const PIECE_BYTES = 8 * 2 ** 20;
const STORED = "fastsplat-upload ";

/** Sends a file in pieces, from where it stopped if a part is there; `sent` gets the bytes so far; returns its id. */
export async function sendFile(
  chosen: ChosenFile,
  signal: AbortSignal,
  sent: (bytes: number) => void,
): Promise<string> {
  const { file } = chosen;
  await discarding;
  const known = localStorage.getItem(storedName(chosen));
  let offset = known ? await offsetOf(known) : null;
  let id = known ?? "";
  if (offset === null) {
    id = await create(chosen);
    localStorage.setItem(storedName(chosen), id);
    offset = 0;
  }
  sent(offset);
  while (offset < file.size) {
    const base = offset;
    const piece = file.slice(offset, offset + PIECE_BYTES);
    offset = await append(id, base, piece, signal, (bytes) => sent(base + bytes));
    sent(offset);
  }
  return id;
}

/** Whether a part of the file has been sent before. */
export function wasBegun(chosen: ChosenFile): boolean {
  return localStorage.getItem(storedName(chosen)) !== null;
}

/** Forgets uploads that have become a scene. */
export function forget(files: readonly ChosenFile[]): void {
  for (const chosen of files) localStorage.removeItem(storedName(chosen));
}

let discarding: Promise<unknown> = Promise.resolve();

/** Takes back what has been sent of files that are not wanted any more: a link for one upload has room for one. */
export function discard(files: readonly ChosenFile[]): Promise<unknown> {
  const ids = files.map((chosen) => localStorage.getItem(storedName(chosen)));
  forget(files);
  discarding = Promise.all([
    discarding,
    ...ids.map((id) => {
      if (id === null) return null;
      const path = `v1/uploads/${encodeURIComponent(id)}`;
      return send(path, { method: "DELETE", headers: VERSION }).catch(() => undefined); // it expires by itself
    }),
  ]);
  return discarding;
}

function storedName({ file, path }: ChosenFile): string {
  return `${STORED}${path} ${file.size} ${file.lastModified}`;
}

async function create({ file, path }: ChosenFile): Promise<string> {
  const name = btoa(String.fromCharCode(...new TextEncoder().encode(path)));
  const response = await send("v1/uploads", {
    method: "POST",
    headers: { ...VERSION, "Upload-Length": String(file.size), "Upload-Metadata": `filename ${name}` },
  });
  await response.arrayBuffer(); // a body that nobody reads is shown as a request that failed
  // The id alone: the address may name another way through a proxy than ours.
  return response.headers.get("Location")?.split("/").pop() ?? "";
}

/** How far an upload has come; null if the server has it no more. */
async function offsetOf(id: string): Promise<number | null> {
  try {
    const response = await send(`v1/uploads/${encodeURIComponent(id)}`, { method: "HEAD", headers: VERSION });
    return Number(response.headers.get("Upload-Offset"));
  } catch (error) {
    if (error instanceof ApiError && (error.status === 404 || error.status === 410)) return null;
    throw error;
  }
}

/** Sends one piece by XMLHttpRequest (fetch does not say how much has been sent); returns the new offset. */
function append(
  id: string,
  offset: number,
  piece: Blob,
  signal: AbortSignal,
  sent: (bytes: number) => void,
): Promise<number> {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    const stop = () => request.abort();
    signal.addEventListener("abort", stop);
    const end = (act: () => void) => {
      signal.removeEventListener("abort", stop);
      act();
    };
    request.upload.addEventListener("progress", (event) => sent(event.loaded));
    request.addEventListener("load", () =>
      end(() => {
        if (request.status === 204) resolve(Number(request.getResponseHeader("Upload-Offset")));
        else {
          if (request.status === 401) refuseKey();
          reject(new ApiError(request.status, problemIn(request.responseText)));
        }
      }),
    );
    request.addEventListener("error", () => end(() => reject(new OfflineError())));
    request.addEventListener("abort", () => end(() => reject(new DOMException("paused", "AbortError"))));
    request.open("PATCH", `v1/uploads/${encodeURIComponent(id)}`);
    const headers = {
      ...keyHeaders(),
      ...VERSION,
      "Upload-Offset": String(offset),
      "Content-Type": "application/offset+octet-stream",
    };
    for (const [name, value] of Object.entries(headers)) request.setRequestHeader(name, value);
    if (signal.aborted) stop();
    else request.send(piece);
  });
}

function problemIn(text: string): Partial<Problem> {
  try {
    return JSON.parse(text) as Problem;
  } catch {
    return {};
  }
}
