import type { ComponentChildren } from "preact";
import { useEffect, useRef, useState } from "preact/hooks";

import type { Match, SceneObject } from "../api/types";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { percent } from "../texts/figures";
import { Chip } from "../ui/Chip";
import { ErrorNote } from "../ui/parts";
import { boxSize, centerOf } from "../viewer/boxes";
import type { Vec } from "../viewer/vectors";
import { KnownLabels, ObjectChips, QuestionForm, Verdict } from "./askParts";
import { FollowUps } from "./FollowUps";
import { knownNames } from "./knownNames";

const TYPING_MS = 350;
const SHOWN_MATCHES = 4;
const LEAST_FIT = 0.01; // below, a name is no offer
const SHOWN_LABELS = 16;

interface Properties {
  state: SceneState;
  onAsk: () => void;
  onFly: (middle: Vec, size: number, views?: readonly string[]) => void;
  /** What can be done about something that is not here. */
  lookAgain: (text: string) => ComponentChildren;
}

/** A question, answered as typing stops. */
export function AskPanel({ state, onAsk, onFly, lookAgain }: Properties) {
  const asked = state.text.value;
  // What is typed belongs to the question it was typed over: an effect would run after the first keys of a fast typist.
  const [draft, setDraft] = useState({ over: asked, text: asked });
  const typed = draft.over === asked ? draft.text : asked;
  const timer = useRef(0);
  const answer = state.answer.value;

  useEffect(() => () => window.clearTimeout(timer.current), []);
  const flyTo = ({ box, best_views: views }: SceneObject) => box && onFly(centerOf(box), boxSize(box), views);
  const flyToObject = (id: number) => {
    const box = state.objects.value?.find((object) => object.id === id)?.box;
    if (box) onFly(centerOf(box), boxSize(box));
  };
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
  const labels = knownNames(state.objects.value ?? []).slice(0, SHOWN_LABELS);
  return (
    <section class="ask" aria-labelledby="ask-title">
      <h2 id="ask-title" class="sr-only">
        {texts.ask.title}
      </h2>
      <QuestionForm text={typed} placeholder={texts.ask.placeholder} onType={type} onAsk={() => ask(typed)} />
      {state.answerError.value !== null && <ErrorNote error={state.answerError.value} />}
      <div aria-live="polite" aria-busy={state.asking.value}>
        {answer && <Verdict answer={answer} />}
      </div>
      {answer && (
        <>
          <ObjectChips objects={answer.objects ?? []} onFly={flyTo} />
          <FollowUps state={state} answer={answer} onAsk={type} onObject={flyToObject} lookAgain={lookAgain} />
          {answer.outcome !== "cannot_say" && (
            <Others
              title={answer.outcome === "here" ? texts.ask.otherNames : texts.ask.others}
              matches={answer.matches
                .filter((match) => !match.relevant && fit(match) >= LEAST_FIT)
                .slice(0, SHOWN_MATCHES)}
              onAsk={type}
            />
          )}
        </>
      )}
      {!answer && labels.length > 0 && <KnownLabels labels={labels} onAsk={type} />}
    </section>
  );
}

const fit = (match: Match): number => match.probability ?? match.relevancy;

/** What else may be meant, with how well each fits. */
function Others({ title, matches, onAsk }: { title: string; matches: Match[]; onAsk: (text: string) => void }) {
  if (matches.length === 0) return null;
  return (
    <>
      <h3>{title}</h3>
      <ul class="chips">
        {matches.map((match) => {
          const share = percent(fit(match));
          return (
            <Chip
              key={match.label_id}
              label={`${texts.ask.askFor(match.label)} ${share}`}
              behind={<span class="hint">{share}</span>}
              onClick={() => onAsk(match.label)}
            >
              {match.label}
            </Chip>
          );
        })}
      </ul>
    </>
  );
}
