import { useState } from "preact/hooks";

import { agreeToNamer, askNamer } from "../api/namerCalls";
import { mayDo } from "../api/roles";
import { serverStatus } from "../api/serverCalls";
import type { Operation } from "../api/types";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { ErrorNote } from "../ui/parts";
import { useLoaded } from "../ui/useLoaded";
import { Outcome } from "./SceneOrder";

/** The server's namer: to which host pictures would go, the project's agreement, and what it said. */
export function NamerPanel({ state }: { state: SceneState }) {
  const { value: status, reload } = useLoaded(serverStatus, []);
  const [started, setStarted] = useState<Operation | null>(null);
  const [failure, setFailure] = useState<unknown>(null);
  const namer = status?.namer;
  const unnamed = state.objects.value?.some((object) => !object.name);
  if (!namer || (!unnamed && !started)) return null;
  const { host, model, agreed } = namer;
  const agree = (to: string) => {
    setFailure(null);
    agreeToNamer(to).then(reload, setFailure);
  };
  const ask = () => {
    setFailure(null);
    askNamer(state.sceneId).then(setStarted, setFailure);
  };
  return (
    <section class="objects" aria-labelledby="namer-title">
      <h2 id="namer-title">{texts.namer.title}</h2>
      <p class="hint">{agreed ? texts.namer.agreed(host, model) : texts.namer.asks(host, model)}</p>
      {!agreed && !mayDo(status.role, "admin") && <p class="hint">{texts.namer.adminAgrees}</p>}
      <div class="buttons">
        {agreed && <Button disabled={state.busy.value} onClick={ask} text={texts.namer.ask(model)} />}
        {mayDo(status.role, "admin") && (
          <Button
            onClick={() => agree(agreed ? "" : host)}
            text={agreed ? texts.namer.takeBack : texts.namer.agree(host)}
          />
        )}
      </div>
      {started && (
        <Outcome
          key={started.id}
          operationId={started.id}
          words={texts.namer}
          result={outcome}
          onDone={() => void state.refresh()}
        />
      )}
      {failure !== null && <ErrorNote error={failure} />}
    </section>
  );
}

function outcome({ ask_namer: told }: Operation) {
  return (
    told && (
      <p>
        {texts.namer.told(told.suggested, told.shown, told.refused)} {told.problem}
      </p>
    )
  );
}
