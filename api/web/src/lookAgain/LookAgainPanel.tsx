import { useRef, useState } from "preact/hooks";

import { getOperation, newRequestId } from "../api/calls";
import { postJson } from "../api/http";
import type { Operation } from "../api/types";
import { texts } from "../texts";
import { ErrorNote, sentence } from "../ui/parts";
import { useLoaded } from "../ui/useLoaded";

const PAUSE_MS = 2_000;

/** Names to search the scene for once more, by the server's open-set detector; what came of it. */
export function LookAgainPanel({ sceneId, onDone }: { sceneId: string; onDone: () => void }) {
  const [started, setStarted] = useState<Operation | null>(null);
  const [error, setError] = useState<unknown>(null);
  const [busy, setBusy] = useState(false);
  const field = useRef<HTMLInputElement>(null);
  const look = async () => {
    const names = (field.current?.value ?? "").split(",").map((name) => name.trim());
    setBusy(true);
    setError(null);
    try {
      const body = { texts: names.filter(Boolean), request_id: newRequestId() };
      setStarted(await postJson<Operation>(`v1/scenes/${encodeURIComponent(sceneId)}:lookAgain`, body));
    } catch (problem) {
      setError(problem);
    } finally {
      setBusy(false);
    }
  };
  return (
    <details class="look-again">
      <summary>{texts.lookAgain.title}</summary>
      <p class="hint">{texts.lookAgain.help}</p>
      <form
        onSubmit={(event) => {
          event.preventDefault();
          void look();
        }}
      >
        <label>
          {texts.lookAgain.names}
          <input ref={field} required autocomplete="off" />
        </label>
        {error !== null && <ErrorNote error={error} />}
        <button class="primary" disabled={busy}>
          {texts.lookAgain.submit}
        </button>
      </form>
      {started && <Outcome key={started.id} operationId={started.id} onDone={onDone} />}
    </details>
  );
}

function Outcome({ operationId, onDone }: { operationId: string; onDone: () => void }) {
  const told = useRef(false);
  const { value, error } = useLoaded(
    async (signal) => {
      const operation = await getOperation(operationId, signal);
      if (operation.state === "SUCCEEDED" && !told.current) {
        told.current = true;
        onDone();
      }
      return operation;
    },
    [operationId],
    (operation) => (operation?.done ? null : PAUSE_MS),
  );
  if (error !== null) return <ErrorNote error={error} />;
  if (!value) return null;
  const result = value.look_again;
  const stage = value.stages.at(-1);
  const named = result?.named.map((each) => each.name) ?? [];
  const suggested = result?.suggested.map((each) => each.name) ?? [];
  return (
    <div class="note" role="status">
      <p>{texts.lookAgain.states[value.state]}</p>
      {!value.done && stage && <progress max={1} value={stage.fraction} aria-label={texts.lookAgain.title} />}
      {value.error && <p>{sentence(value.error.message)}</p>}
      {value.error?.details["hint"] && <p class="hint">{value.error.details["hint"]}</p>}
      {result && named.length > 0 && <p>{texts.lookAgain.named(named.join(", "))}</p>}
      {result && suggested.length > 0 && <p>{texts.lookAgain.suggested(suggested.join(", "))}</p>}
      {result && named.length + suggested.length === 0 && <p>{texts.lookAgain.nothing}</p>}
    </div>
  );
}
