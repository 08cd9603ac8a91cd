import { useState } from "preact/hooks";

import { cancelOperation } from "../api/calls";
import type { Operation, StageProgress } from "../api/types";
import { texts } from "../texts";
import { percent } from "../texts/figures";
import { Button } from "../ui/Button";
import { ErrorNote } from "../ui/parts";
import { sentence } from "../ui/sentence";
import { FinishButton } from "./FinishButton";
import { JobPreview } from "./JobPreview";
import { LeftOutFiles } from "./LeftOutFiles";
import { PlacedView } from "./PlacedView";
import { RetryOffer } from "./RetryOffer";
import { duration, jobCountdown, stageCountdown, waiting } from "./timing";
import { useTimeLeft } from "./useTimeLeft";
import { WorkerNote } from "./WorkerNote";

/** The stages of a job, why it failed, and what can be done about it; how long it takes may stand elsewhere. */
export function JobPanel(props: { operation: Operation; onChange: () => void; timed?: boolean }) {
  const { operation, onChange, timed = true } = props;
  const [error, setError] = useState<unknown>(null);
  const [busy, setBusy] = useState(false);
  const act = (call: (id: string) => Promise<void>) => {
    setBusy(true);
    setError(null);
    call(operation.id)
      .then(onChange, setError)
      .finally(() => setBusy(false));
  };
  return (
    <section class="job" aria-labelledby="job-title">
      <h2 id="job-title">{texts.job.title}</h2>
      <p class="sr-only" role="status">
        {announcement(operation)}
      </p>
      <WorkerNote operation={operation} />
      {timed && <JobLeft operation={operation} />}
      {operation.state === "CANCELLED" && (
        <p class="note" role="status">
          {texts.job.cancelled}
        </p>
      )}
      <JobError operation={operation} />
      <LeftOutFiles files={operation.left_out} />
      <ol class="stages">
        {operation.stages.map((stage, index) => (
          <Stage key={stage.stage} stage={stage} active={!operation.done && index === operation.stages.length - 1} />
        ))}
      </ol>
      {!operation.done && <FinishButton operation={operation} busy={busy} act={act} />}
      {!operation.done && <Button disabled={busy} onClick={() => act(cancelOperation)} text={texts.job.cancel} />}
      <RetryOffer operation={operation} busy={busy} act={act} />
      {error !== null && <ErrorNote error={error} />}
    </section>
  );
}

/** Why a job failed. */
export function JobError({ operation: { error } }: { operation: Operation }) {
  if (!error) return null;
  const { field, limit, hint } = error.details;
  return (
    <div class="note error" role="alert">
      <p>{texts.job.failed(texts.job.stages[error.stage] ?? error.stage)}</p>
      <p>{sentence(error.message, field)}</p>
      {limit && <p>{texts.limit(limit)}</p>}
      {hint && <p class="hint">{hint}</p>}
    </div>
  );
}

/** How long a job still takes, while that is known. */
export function JobLeft({ operation }: { operation: Operation }) {
  const left = useTimeLeft((previous, now) => jobCountdown(previous, operation.seconds_left, now), !operation.done);
  return left !== null && <p class="job-left">{texts.jobWatching.left(duration(left))}</p>;
}

/** What a job shows of its scene: beside what it says of itself, so that both are in view. */
export function JobFigures({ operation }: { operation: Operation }) {
  if (!operation.preview && !operation.placed) return null;
  return (
    <div class="job-figures">
      {operation.preview && <JobPreview operationId={operation.id} info={operation.preview} />}
      {operation.placed && <PlacedView operationId={operation.id} info={operation.placed} />}
    </div>
  );
}

function Stage({ stage, active }: { stage: StageProgress; active: boolean }) {
  const name = texts.job.stages[stage.stage] ?? stage.stage;
  const done = stage.fraction >= 1;
  const known = useTimeLeft((previous, now) => stageCountdown(previous, stage, now), active);
  const left = active && !done ? known : null;
  return (
    <li>
      <span class="stage-name">{name}</span>
      <span class="hint">{done ? texts.job.done : percent(stage.fraction)}</span>
      <progress max={1} value={stage.fraction} aria-label={name} />
      <span class="hint">
        {[done ? "" : stage.message, stageTime(stage, active, left)].filter(Boolean).join(" · ")}
      </span>
    </li>
  );
}

/** How long a stage still takes, has taken so far, or took. */
function stageTime(stage: StageProgress, active: boolean, left: number | null): string {
  if (!active || stage.fraction >= 1) return texts.job.took(duration(stage.seconds));
  return left === null ? texts.job.spent(duration(stage.seconds)) : texts.job.left(duration(left));
}

/** What a screen reader is told when it changes: the stage, in steps of ten percent; its end is said where it stands. */
function announcement(operation: Operation): string {
  const stage = operation.stages.at(-1);
  if (operation.done) return "";
  if (!stage) return waiting(operation);
  const tens = Math.floor(stage.fraction * 10) / 10;
  return `${texts.job.stages[stage.stage] ?? stage.stage}: ${percent(tens)}`;
}
