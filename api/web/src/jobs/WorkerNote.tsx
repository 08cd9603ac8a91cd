import type { Operation } from "../api/types";
import { texts } from "../texts";
import { waiting } from "./timing";

/** Who works on a job that is not done: nobody is there, it waits for its turn, its worker is silent, it was taken up anew. */
export function WorkerNote({ operation }: { operation: Operation }) {
  if (operation.done) return null;
  const again = operation.attempt > 1 && operation.worker === "working" && operation.again_after;
  return (
    <>
      {operation.worker === "none" && <p class="note error">{texts.jobWatching.noWorker}</p>}
      {operation.worker === "silent" && <p class="note error">{texts.jobWatching.silent}</p>}
      {operation.worker === "waiting" && <p>{waiting(operation)}</p>}
      {again && <p class="note">{texts.jobWatching.attempt(operation.attempt, texts.jobWatching.againAfter[again])}</p>}
    </>
  );
}
