import { getOperation } from "../api/calls";
import { texts } from "../texts";
import { useLoaded } from "../ui/useLoaded";
import { waiting } from "./timing";

/** One line of how far a job is, for a card. */
export function Progress({ operationId }: { operationId: string }) {
  const { value } = useLoaded(
    (signal) => getOperation(operationId, signal),
    [operationId],
    (operation) => (operation?.done ? null : 3_000),
  );
  const stage = value?.stages.at(-1);
  if (!value || value.done) return null;
  if (!stage) return <span class="hint">{waiting(value)}</span>;
  const name = texts.job.stages[stage.stage] ?? stage.stage;
  return (
    <span class="progress-line">
      <span class="hint">{name}</span>
      <progress max={1} value={stage.fraction} aria-label={name} />
    </span>
  );
}
