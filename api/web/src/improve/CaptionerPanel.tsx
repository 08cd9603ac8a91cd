import { useState } from "preact/hooks";

import { agreeToCaptioner, askCaptioner } from "../api/captionerCalls";
import { mayDo } from "../api/roles";
import { serverStatus } from "../api/serverCalls";
import type { Operation } from "../api/types";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { ErrorNote } from "../ui/parts";
import { useLoaded } from "../ui/useLoaded";
import { Outcome } from "./SceneOrder";

/** The server's captioner: to which host pictures would go, the project's agreement, and what it said. */
export function CaptionerPanel({ state }: { state: SceneState }) {
  const { value: status, reload } = useLoaded(serverStatus, []);
  const [started, setStarted] = useState<Operation | null>(null);
  const [failure, setFailure] = useState<unknown>(null);
  const captioner = status?.captioner;
  const unnamed = state.objects.value?.some((object) => !object.name);
  if (!captioner || (!unnamed && !started)) return null;
  const { host, model, agreed } = captioner;
  const agree = (to: string) => {
    setFailure(null);
    agreeToCaptioner(to).then(reload, setFailure);
  };
  const ask = () => {
    setFailure(null);
    askCaptioner(state.sceneId).then(setStarted, setFailure);
  };
  return (
    <section class="objects" aria-labelledby="captioner-title">
      <h2 id="captioner-title">{texts.captioner.title}</h2>
      <p class="hint">{agreed ? texts.captioner.agreed(host, model) : texts.captioner.asks(host, model)}</p>
      {!agreed && !mayDo(status.role, "admin") && <p class="hint">{texts.captioner.adminAgrees}</p>}
      <div class="buttons">
        {agreed && <Button disabled={state.busy.value} onClick={ask} text={texts.captioner.ask(model)} />}
        {mayDo(status.role, "admin") && (
          <Button
            onClick={() => agree(agreed ? "" : host)}
            text={agreed ? texts.captioner.takeBack : texts.captioner.agree(host)}
          />
        )}
      </div>
      {started && (
        <Outcome
          key={started.id}
          operationId={started.id}
          words={texts.captioner}
          result={outcome}
          onDone={() => void state.refresh()}
        />
      )}
      {failure !== null && <ErrorNote error={failure} />}
    </section>
  );
}

function outcome({ ask_captioner: told }: Operation) {
  return (
    told && (
      <p>
        {texts.captioner.told(told.suggested, told.objects, told.refused)} {told.problem}
      </p>
    )
  );
}
