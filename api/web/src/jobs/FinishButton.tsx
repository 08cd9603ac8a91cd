import { useState } from "preact/hooks";

import { send } from "../api/http";
import type { Operation } from "../api/types";
import { texts } from "../texts";
import { Button } from "../ui/Button";

/** Ends a training early and keeps what is there, while the job trains; `act` runs the call. */
export function FinishButton({
  operation,
  busy,
  act,
}: {
  operation: Operation;
  busy: boolean;
  act: (call: (id: string) => Promise<void>) => void;
}) {
  const [asking, setAsking] = useState(false);
  const training = operation.stages.at(-1);
  if (operation.finish_requested) return <p role="status">{texts.jobWatching.finishing}</p>;
  if (training?.stage !== "training" || training.fraction >= 1 || !training.metrics["iteration"]) return null;
  if (!asking) return <Button disabled={busy} onClick={() => setAsking(true)} text={texts.jobWatching.finish} />;
  return (
    <div class="note">
      <p>{texts.jobWatching.finishQuestion}</p>
      <span class="buttons">
        <Button
          class="primary"
          disabled={busy}
          onClick={() => act(finishOperation)}
          text={texts.jobWatching.finishYes}
        />
        <Button onClick={() => setAsking(false)} text={texts.jobWatching.finishNo} />
      </span>
    </div>
  );
}

async function finishOperation(operationId: string): Promise<void> {
  await send(`v1/operations/${encodeURIComponent(operationId)}:finish`, { method: "POST" });
}
