import { signal } from "@preact/signals";

import { newRequestId } from "../api/calls";
import { isAbort, OfflineError, send } from "../api/http";
import type { Operation } from "../api/types";
import { texts } from "../texts";
import type { ChosenFile } from "./choose";
import { totalBytes } from "./choose";
import { forget, sendFile } from "./tus";

/** One upload until its scene is ordered; it goes on while the page shows something else. */
export class Uploading {
  readonly files: readonly ChosenFile[];
  readonly total: number;
  readonly sent = signal({ bytes: 0, speed: 0 });
  readonly busy = signal(false);
  readonly error = signal<unknown>(null);
  readonly operation = signal<Operation | null>(null);
  readonly id = newRequestId();
  readonly #form: HTMLFormElement;
  #controller = new AbortController();

  /** @param form says what else the scene is to be; it is read when the files are there, on show or not. */
  constructor(files: readonly ChosenFile[], form: HTMLFormElement) {
    this.files = files;
    this.total = totalBytes(files);
    this.#form = form;
  }

  get name(): string {
    const name = new FormData(this.#form).get("name");
    return typeof name === "string" && name ? name : (this.files[0]?.path ?? "");
  }

  /** Begins, or goes on where it stopped. */
  async run(): Promise<void> {
    this.#controller = new AbortController();
    this.busy.value = true;
    this.error.value = null;
    try {
      const ids = await this.#sendAll(this.#controller.signal);
      this.operation.value = await createScene(new FormData(this.#form), ids, this.id);
      forget(this.files);
    } catch (problem) {
      if (problem instanceof OfflineError) this.error.value = new Error(texts.upload.interrupted);
      else if (!isAbort(problem)) this.error.value = problem;
    }
    this.busy.value = false;
    this.sent.value = { ...this.sent.value, speed: 0 };
  }

  pause(): void {
    this.#controller.abort();
  }

  async #sendAll(signal: AbortSignal): Promise<string[]> {
    const ids: string[] = [];
    const begin = performance.now();
    let done = 0;
    let there = 0; // bytes that an earlier attempt has sent
    for (const each of this.files) {
      let first = true;
      const before = done;
      const id = await sendFile(each, signal, (bytes) => {
        if (first) there += bytes;
        first = false;
        const seconds = Math.max((performance.now() - begin) / 1000, 0.1);
        this.sent.value = { bytes: before + bytes, speed: Math.max(0, before + bytes - there) / seconds };
      });
      ids.push(id);
      done += each.file.size;
    }
    return ids;
  }
}

/** Uploads whose form has been left before they were through. */
export const leftUploads = signal<readonly Uploading[]>([]);

async function createScene(chosen: FormData, uploads: readonly string[], requestId: string): Promise<Operation> {
  const form = new FormData();
  for (const [name, value] of chosen) if (typeof value === "string" && value) form.append(name, value);
  form.append("request_id", requestId);
  for (const id of uploads) form.append("uploads", id);
  return (await (await send("v1/scenes", { method: "POST", body: form })).json()) as Operation;
}
