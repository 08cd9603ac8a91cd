import { useEffect, useRef, useState } from "preact/hooks";

import type { Match, SceneObject } from "../api/types";
import { BestPhotos } from "../look/BestPhotos";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { ErrorNote } from "../ui/parts";
import { boxSize, centerOf } from "../viewer/boxes";
import type { Vec } from "../viewer/vectors";
import { KnownLabels, ObjectChips, QuestionForm, Verdict } from "./askParts";
import { knownNames } from "./knownNames";

const TYPING_MS = 350;
const SHOWN_MATCHES = 6;
const SHOWN_LABELS = 30;

interface Properties {
  state: SceneState;
  onAsk: () => void;
  onFly: (middle: Vec, size: number) => void;
}

/** A question, answered as typing stops. */
export function AskPanel({ state, onAsk, onFly }: Properties) {
  const asked = state.text.value;
  // What is typed belongs to the question it was typed over: an effect would run after the first keys of a fast typist.
  const [draft, setDraft] = useState({ over: asked, text: asked });
  const typed = draft.over === asked ? draft.text : asked;
  const timer = useRef(0);
  const answer = state.answer.value;

  useEffect(() => () => window.clearTimeout(timer.current), []);
  const flyTo = ({ box }: SceneObject) => onFly(centerOf(box), boxSize(box));
  const ask = (text: string) => {
    window.clearTimeout(timer.current);
    void state.ask(text).then(() => {
      onAsk();
      const [best] = state.answer.value?.objects ?? [];
      if (best && state.answer.value?.text === text.trim()) flyTo(best);
    });
  };
  const type = (text: string) => {
    setDraft({ over: asked, text });
    window.clearTimeout(timer.current);
    timer.current = window.setTimeout(() => ask(text), TYPING_MS);
  };
  const labels = knownNames(state.things.value ?? []).slice(0, SHOWN_LABELS);
  return (
    <section class="ask" aria-labelledby="ask-title">
      <h2 id="ask-title">{texts.ask.title}</h2>
      <QuestionForm text={typed} placeholder={texts.ask.placeholder} onType={type} onAsk={() => ask(typed)} />
      {state.answerError.value !== null && <ErrorNote error={state.answerError.value} />}
      <div aria-live="polite" aria-busy={state.asking.value}>
        {answer && <Verdict answer={answer} />}
      </div>
      {answer && (
        <>
          <ObjectChips objects={answer.objects ?? []} onFly={flyTo} />
          {(answer.outcome === "here" || answer.outcome === "probably_here") && (
            <BestPhotos state={state} text={answer.text} />
          )}
          <Matches matches={answer.matches.slice(0, SHOWN_MATCHES)} onAsk={type} />
        </>
      )}
      {!answer && labels.length > 0 && <KnownLabels labels={labels} onAsk={type} />}
    </section>
  );
}

function Matches({ matches, onAsk }: { matches: Match[]; onAsk: (text: string) => void }) {
  return (
    <>
      <h3>{texts.ask.matches}</h3>
      <ol class="matches">
        {matches.map((match) => {
          const share = match.probability ?? match.relevancy;
          return (
            <li key={match.label_id} class={match.relevant ? "relevant" : ""}>
              <button
                type="button"
                class="plain"
                aria-label={texts.ask.askFor(match.label)}
                onClick={() => onAsk(match.label)}
              >
                {match.label}
              </button>
              <meter min={0} max={1} value={share} aria-label={match.label} />
              <span class="hint figure">{texts.job.percent(share)}</span>
            </li>
          );
        })}
      </ol>
    </>
  );
}
