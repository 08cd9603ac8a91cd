import { useState } from "preact/hooks";

import { agreeToNamer, askNamer } from "../api/namerCalls";
import { mayDo } from "../api/roles";
import { serverStatus } from "../api/serverCalls";
import type { NamerResult } from "../api/types";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { ErrorNote } from "../ui/parts";
import { useLoaded } from "../ui/useLoaded";

/** The server's namer: to which host pictures would go, the project's agreement, and what it said. */
export function NamerPanel({ state }: { state: SceneState }) {
  const { value: status, reload } = useLoaded(serverStatus, []);
  const [asking, setAsking] = useState(false);
  const [told, setTold] = useState<NamerResult | null>(null);
  const [failure, setFailure] = useState<unknown>(null);
  const namer = status?.namer;
  const unnamed = state.things.value?.some((thing) => !thing.name);
  if (!namer || (!unnamed && !told)) return null;
  const { host, model, agreed } = namer;
  const agree = (to: string) => {
    setFailure(null);
    agreeToNamer(to).then(reload, setFailure);
  };
  const ask = () => {
    setFailure(null);
    setTold(null);
    setAsking(true);
    askNamer(state.sceneId)
      .then(setTold, setFailure)
      .finally(() => {
        setAsking(false);
        void state.refresh();
      });
  };
  return (
    <section class="things" aria-labelledby="namer-title">
      <h2 id="namer-title">{texts.namer.title}</h2>
      <p class="hint">{agreed ? texts.namer.agreed(host, model) : texts.namer.asks(host, model)}</p>
      {!agreed && !mayDo(status.role, "admin") && <p class="hint">{texts.namer.adminAgrees}</p>}
      <div class="buttons">
        {agreed && (
          <button type="button" disabled={asking || state.busy.value} onClick={ask}>
            {asking ? texts.namer.asking : texts.namer.ask(model)}
          </button>
        )}
        {mayDo(status.role, "admin") && (
          <button type="button" disabled={asking} onClick={() => agree(agreed ? "" : host)}>
            {agreed ? texts.namer.takeBack : texts.namer.agree(host)}
          </button>
        )}
      </div>
      {told && (
        <p class="note" role="status">
          {texts.namer.told(told.suggested, told.shown, told.refused)} {told.problem}
        </p>
      )}
      {failure !== null && <ErrorNote error={failure} />}
    </section>
  );
}
