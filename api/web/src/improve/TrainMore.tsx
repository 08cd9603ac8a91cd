import { useRef, useState } from "preact/hooks";

import { cancelOperation, getOperation, newRequestId } from "../api/calls";
import { postJson } from "../api/http";
import type { Operation } from "../api/types";
import { FinishButton } from "../jobs/FinishButton";
import { JobPreview } from "../jobs/JobPreview";
import { texts } from "../texts";
import { ErrorNote, sentence } from "../ui/parts";
import { useLoaded } from "../ui/useLoaded";
import "./improve.css";

const PAUSE_MS = 2_000;
const PRESETS = ["draft", "balanced", "best"] as const;

/** Trains the scene further, from where it is; the job is followed to its end. */
export function TrainMore({ sceneId, onDone }: { sceneId: string; onDone: () => void }) {
  const [started, setStarted] = useState<Operation | null>(null);
  const [error, setError] = useState<unknown>(null);
  const [busy, setBusy] = useState(false);
  const preset = useRef<HTMLSelectElement>(null);
  const train = async () => {
    setBusy(true);
    setError(null);
    try {
      const body = { preset: preset.current?.value ?? PRESETS[1], request_id: newRequestId() };
      setStarted(await postJson<Operation>(`v1/scenes/${encodeURIComponent(sceneId)}:trainMore`, body));
    } catch (problem) {
      setError(problem);
    } finally {
      setBusy(false);
    }
  };
  return (
    <details class="improve">
      <summary>{texts.trainMore.title}</summary>
      <p class="hint">{texts.trainMore.help}</p>
      <form
        onSubmit={(event) => {
          event.preventDefault();
          void train();
        }}
      >
        <label>
          {texts.trainMore.preset}
          <select ref={preset}>
            {PRESETS.map((name) => (
              <option key={name} value={name} selected={name === PRESETS[1]}>
                {texts.trainMore.presets[name]}
              </option>
            ))}
          </select>
        </label>
        {error !== null && <ErrorNote error={error} />}
        <button class="primary" disabled={busy}>
          {texts.trainMore.submit}
        </button>
      </form>
      {started && <Outcome key={started.id} operationId={started.id} onDone={onDone} />}
    </details>
  );
}

function Outcome({ operationId, onDone }: { operationId: string; onDone: () => void }) {
  const told = useRef(false);
  const [busy, setBusy] = useState(false);
  const [problem, setProblem] = useState<unknown>(null);
  const { value, error, reload } = useLoaded(
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
  const act = (call: (id: string) => Promise<void>) => {
    setBusy(true);
    setProblem(null);
    call(operationId)
      .then(reload, setProblem)
      .finally(() => setBusy(false));
  };
  if (error !== null && value === null) return <ErrorNote error={error} />;
  if (!value) return null;
  const result = value.train_more;
  const stage = value.stages.at(-1);
  return (
    <div class="note">
      <p role="status">{texts.trainMore.states[value.state]}</p>
      {!value.done && stage && <progress max={1} value={stage.fraction} aria-label={texts.trainMore.title} />}
      {!value.done && stage && <p class="hint">{stage.message}</p>}
      {value.preview && <JobPreview operationId={operationId} info={value.preview} />}
      {value.error && <p>{sentence(value.error.message)}</p>}
      {value.error?.details["hint"] && <p class="hint">{value.error.details["hint"]}</p>}
      {result && result.psnr !== null && result.psnr_before !== null && (
        <p>{texts.trainMore.better(result.psnr_before, result.psnr)}</p>
      )}
      {result && !result.current && <p>{texts.trainMore.beside}</p>}
      {problem !== null && <ErrorNote error={problem} />}
      {!value.done && (
        <span class="buttons">
          <FinishButton operation={value} busy={busy} act={act} />
          <button type="button" disabled={busy} onClick={() => act(cancelOperation)}>
            {texts.trainMore.cancel}
          </button>
        </span>
      )}
    </div>
  );
}
