import type { ComponentChildren } from "preact";
import { useRef, useState } from "preact/hooks";

import { cancelOperation, getOperation, newRequestId } from "../api/calls";
import { postJson } from "../api/http";
import type { Operation } from "../api/types";
import { waiting } from "../jobs/timing";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { Form } from "../ui/fields";
import { ErrorNote } from "../ui/parts";
import { sentence } from "../ui/sentence";
import { useLoaded } from "../ui/useLoaded";
import "./improve.css";

const PAUSE_MS = 2_000;

interface FollowProps {
  words: { title: string; running: string };
  /** What came of it, once there is something to say. */
  result: (operation: Operation) => ComponentChildren;
  onDone: () => void;
}

interface Props extends FollowProps {
  words: FollowProps["words"] & { help: string; submit: string };
  sceneId: string;
  /** The call that queues the job, as in `v1/scenes/{scene_id}:{call}`. */
  call: string;
  /** Its body, without the request id. */
  body: (form: FormData) => object;
  /** The fields of the form. */
  children: ComponentChildren;
}

/** A form that orders a job for a finished scene; the job is followed to its end. */
export function SceneOrder({ sceneId, call, body, children, ...follow }: Props) {
  const [started, setStarted] = useState<Operation | null>(null);
  const [error, setError] = useState<unknown>(null);
  const [busy, setBusy] = useState(false);
  const order = async (form: FormData) => {
    setBusy(true);
    setError(null);
    try {
      const path = `v1/scenes/${encodeURIComponent(sceneId)}:${call}`;
      setStarted(await postJson<Operation>(path, { ...body(form), request_id: newRequestId() }));
    } catch (problem) {
      setError(problem);
    } finally {
      setBusy(false);
    }
  };
  return (
    <details class="improve">
      <summary>{follow.words.title}</summary>
      <p class="hint">{follow.words.help}</p>
      <Form onSubmit={(form) => void order(new FormData(form))}>
        {children}
        {error !== null && <ErrorNote error={error} />}
        <Button type="submit" class="primary" disabled={busy} text={follow.words.submit} />
      </Form>
      {started && <Outcome key={started.id} operationId={started.id} {...follow} />}
    </details>
  );
}

/** A job on a finished scene, followed to its end. */
export function Outcome({ operationId, words, result, onDone }: FollowProps & { operationId: string }) {
  const announced = useRef(false);
  const [busy, setBusy] = useState(false);
  const [problem, setProblem] = useState<unknown>(null);
  const { value, error, reload } = useLoaded(
    async (signal) => {
      const operation = await getOperation(operationId, signal);
      if (operation.state === "SUCCEEDED" && !announced.current) {
        announced.current = true;
        onDone();
      }
      return operation;
    },
    [operationId],
    (operation) => (operation?.done ? null : PAUSE_MS),
  );
  const cancel = () => {
    setBusy(true);
    setProblem(null);
    cancelOperation(operationId)
      .then(reload, setProblem)
      .finally(() => setBusy(false));
  };
  if (!value) return error === null ? null : <ErrorNote error={error} />;
  const stage = value.done ? undefined : value.stages.at(-1);
  return (
    <div class="note">
      <div role="status">
        <p>{stateOf(value, words.running)}</p>
        {value.error && <p>{sentence(value.error.message)}</p>}
        {value.error?.details["hint"] && <p class="hint">{value.error.details["hint"]}</p>}
        {result(value)}
      </div>
      {stage && <progress max={1} value={stage.fraction} aria-label={words.title} />}
      {stage && <p class="hint">{stage.message}</p>}
      {problem !== null && <ErrorNote error={problem} />}
      {!value.done && <Button disabled={busy} onClick={cancel} text={texts.cancel} />}
    </div>
  );
}

function stateOf(operation: Operation, running: string): string {
  if (operation.state === "QUEUED") return waiting(operation);
  return operation.state === "RUNNING" ? running : texts.order.states[operation.state];
}
