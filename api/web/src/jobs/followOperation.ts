import { getOperation } from "../api/calls";
import { ApiError, isAbort, send } from "../api/http";
import type { Operation } from "../api/types";
import { EventReader } from "./serverEvents";

const POLL_MS = 1_500;
const GONE = 404;

/**
 * Tells a job's state now and on every change, until it is done: by the server's events, and by asking now and then while
 * these break off (a proxy that buffers, a server that starts anew).
 *
 * @throws ApiError the server does not know the job (any more).
 */
export async function followOperation(
  operationId: string,
  signal: AbortSignal,
  tell: (operation: Operation) => void,
): Promise<void> {
  const stopped = () => signal.aborted; // a function, as it changes between two looks
  let last = "";
  while (!stopped()) {
    try {
      const response = await events(operationId, last, signal);
      if (response.status === 204 || !response.body) return;
      const ended = await read(response.body, (id, operation) => {
        last = id;
        tell(operation);
        return operation.done;
      });
      if (ended) return;
    } catch (error) {
      if (stopped() || isAbort(error)) return;
      if (error instanceof ApiError && error.status === GONE) throw error;
    }
    await pause(signal);
    try {
      const operation = await getOperation(operationId, signal);
      tell(operation);
      if (operation.done) return;
    } catch (error) {
      if (stopped() || isAbort(error)) return;
      if (error instanceof ApiError && error.status === GONE) throw error;
    }
  }
}

function events(operationId: string, last: string, signal: AbortSignal): Promise<Response> {
  return send(`v1/operations/${encodeURIComponent(operationId)}/events`, {
    signal,
    ...(last ? { headers: { "Last-Event-ID": last } } : {}),
  });
}

/** Hands on each event; true once `tell` says that there will be no more. */
async function read(
  body: ReadableStream<Uint8Array>,
  tell: (id: string, operation: Operation) => boolean,
): Promise<boolean> {
  const [reader, decoder, parser] = [body.getReader(), new TextDecoder(), new EventReader()];
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return false;
    for (const event of parser.read(decoder.decode(value, { stream: true })))
      if (event.kind === "error") {
        await reader.cancel();
        return false; // asking for the job tells why
      } else if (tell(event.id, JSON.parse(event.data) as Operation)) {
        await reader.cancel();
        return true;
      }
  }
}

function pause(signal: AbortSignal): Promise<void> {
  return new Promise((resolve) => {
    const timer = window.setTimeout(resolve, POLL_MS);
    signal.addEventListener("abort", () => {
      window.clearTimeout(timer);
      resolve();
    });
  });
}
