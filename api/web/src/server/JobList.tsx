import { useState } from "preact/hooks";

import { sceneAddress } from "../address/router";
import { cancelOperation, listScenes, retryOperation } from "../api/calls";
import { listOperations } from "../api/serverCalls";
import type { Operation } from "../api/types";
import { duration } from "../jobs/timing";
import { texts } from "../texts";
import { momentText, percent } from "../texts/figures";
import { Button } from "../ui/Button";
import { ErrorNote } from "../ui/parts";
import { sentence } from "../ui/sentence";
import { useLoaded } from "../ui/useLoaded";

const STEP = 25;
const BUSY_MS = 3_000;
const QUIET_MS = 15_000;

/** The project's jobs, newest first, with where they stand; those who may cancel and retry them. */
export function JobList({ canChange, onChange }: { canChange: boolean; onChange: () => void }) {
  const [count, setCount] = useState(STEP);
  const [failure, setFailure] = useState<unknown>(null);
  const names = useLoaded(async () => new Map((await listScenes()).map((scene) => [scene.id, scene.name])), []);
  const jobs = useLoaded(
    (signal) => listOperations(count, signal),
    [count],
    (value) => (value?.operations.some((operation) => !operation.done) ? BUSY_MS : QUIET_MS),
  );
  const act = (call: (id: string) => Promise<void>, id: string) => {
    setFailure(null);
    call(id).then(() => {
      jobs.reload();
      onChange();
    }, setFailure);
  };
  const error = jobs.error ?? failure;
  return (
    <section class="server-part" aria-labelledby="jobs-title">
      <h2 id="jobs-title">{texts.server.jobs}</h2>
      {error !== null && <ErrorNote error={error} />}
      {jobs.value?.operations.length === 0 && <p class="hint">{texts.server.noJobs}</p>}
      <ul class="rows" aria-label={texts.server.jobs}>
        {jobs.value?.operations.map((operation) => (
          <Job
            key={operation.id}
            operation={operation}
            name={names.value?.get(operation.scene_id)}
            act={canChange ? act : null}
          />
        ))}
      </ul>
      {jobs.value?.more && <Button onClick={() => setCount(count + STEP)} text={texts.server.more} />}
    </section>
  );
}

interface JobProperties {
  operation: Operation;
  name: string | undefined;
  act: ((call: (id: string) => Promise<void>, id: string) => void) | null;
}

function Job({ operation, name, act }: JobProperties) {
  const stage = operation.stages.at(-1);
  const title = name === undefined ? texts.server.sceneGone : name || texts.scenes.untitled;
  const photos = operation.error?.photos ?? [];
  const seconds = operation.stages.reduce((sum, each) => sum + each.seconds, 0);
  const about = [
    texts.server.kinds[operation.kind],
    momentText(operation.created_at),
    !operation.done && stage ? `${texts.job.stages[stage.stage] ?? stage.stage} ${percent(stage.fraction)}` : "",
    seconds > 0 ? duration(seconds) : "",
  ];
  return (
    <li>
      <span class="row-name">
        {name === undefined ? title : <a href={sceneAddress(operation.scene_id)}>{title}</a>}
      </span>
      <span class={`state ${operation.state === "SUCCEEDED" ? "ready" : operation.state.toLowerCase()}`}>
        {texts.server.states[operation.state]}
      </span>
      <span class="hint">{about.filter(Boolean).join(" · ")}</span>
      {operation.error && <span class="hint">{sentence(operation.error.message)}</span>}
      {act && !operation.done && (
        <Button
          aria-label={texts.server.cancelOf(title)}
          onClick={() => act(cancelOperation, operation.id)}
          text={texts.job.cancel}
        />
      )}
      {act && name !== undefined && (operation.state === "FAILED" || operation.state === "CANCELLED") && (
        <Button
          aria-label={photos.length > 0 ? `${texts.job.leaveOut(photos)}: ${title}` : texts.server.retryOf(title)}
          onClick={() => act((id) => retryOperation(id, photos), operation.id)}
          text={photos.length > 0 ? texts.job.leaveOut(photos) : texts.job.retry}
        />
      )}
    </li>
  );
}
