import type { Operation, Scene } from "../api/types";
import { texts } from "../texts";
import { JobLeft, JobPanel } from "./JobPanel";

/** Beside a draft of a scene: that it is one, of what, and how far its job is. */
export function DraftNote(props: { scene: Scene; operation: Operation | null; onChange: () => void }) {
  const { scene, operation, onChange } = props;
  if (scene.state === "READY" || !scene.provisional) return null;
  const stage = operation?.stages.at(-1);
  return (
    <aside class="draft-note" aria-label={texts.draft.title}>
      <p role="status">
        <strong>{texts.draft.title}</strong> {texts.draft.of[scene.provisional.stage]}{" "}
        {scene.state === "TRAINING" ? texts.draft.goesOn : texts.draft.ended}
      </p>
      {operation && !operation.done && stage && (
        <progress max={1} value={stage.fraction} aria-label={texts.job.stages[stage.stage] ?? stage.stage} />
      )}
      {operation && <JobLeft operation={operation} />}
      {operation && (
        <details open={operation.done}>
          <summary>{texts.job.title}</summary>
          <JobPanel operation={operation} onChange={onChange} timed={false} />
        </details>
      )}
    </aside>
  );
}
