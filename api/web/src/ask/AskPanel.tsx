import { useEffect, useRef, useState } from "preact/hooks";

import type { Answer, Match } from "../api/types";
import { BestPhotos } from "../look/BestPhotos";
import type { SceneState } from "../scene/sceneState";
import { texts } from "../texts";
import { ErrorNote } from "../ui/parts";
import { boxSize, centerOf } from "../viewer/boxes";
import type { Vec } from "../viewer/vectors";

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
  const ask = (text: string) => {
    window.clearTimeout(timer.current);
    void state.ask(text).then(() => {
      onAsk();
      const [best] = state.answer.value?.objects ?? [];
      if (best && state.answer.value?.text === text.trim()) onFly(centerOf(best.box), boxSize(best.box));
    });
  };
  const type = (text: string) => {
    setDraft({ over: asked, text });
    window.clearTimeout(timer.current);
    timer.current = window.setTimeout(() => ask(text), TYPING_MS);
  };
  const labels = state.scene.value?.dictionary ?? [];
  return (
    <section class="ask" aria-labelledby="ask-title">
      <h2 id="ask-title">{texts.ask.title}</h2>
      <form
        role="search"
        onSubmit={(event) => {
          event.preventDefault();
          ask(typed);
        }}
      >
        <label class="sr-only" for="question">
          {texts.ask.label}
        </label>
        <input
          id="question"
          type="search"
          value={typed}
          maxLength={1000}
          placeholder={texts.ask.placeholder}
          autocomplete="off"
          onInput={(event) => type(event.currentTarget.value)}
        />
        <button class="primary">{texts.ask.title}</button>
      </form>
      {state.answerError.value !== null && <ErrorNote error={state.answerError.value} />}
      <div aria-live="polite" aria-busy={state.asking.value}>
        {answer && <Verdict answer={answer} />}
      </div>
      {answer && (
        <>
          <Objects answer={answer} onFly={onFly} />
          {answer.verdict !== "absent" && <BestPhotos state={state} text={answer.text} />}
          <Matches matches={answer.matches.slice(0, SHOWN_MATCHES)} onAsk={type} />
        </>
      )}
      {!answer && labels.length > 0 && (
        <>
          <h3>{texts.ask.knownLabels}</h3>
          <ul class="chips">
            {labels.slice(0, SHOWN_LABELS).map((entry) => (
              <li key={entry.label_id}>
                <button type="button" class="chip" onClick={() => type(entry.label)}>
                  {entry.label}
                </button>
              </li>
            ))}
          </ul>
        </>
      )}
    </section>
  );
}

function Verdict({ answer }: { answer: Answer }) {
  return (
    <div class={`verdict ${answer.verdict}`}>
      <p class="verdict-word">{texts.ask.verdicts[answer.verdict]}</p>
      <p>{answer.explanation}</p>
      {answer.probability !== null && <p class="hint">{texts.ask.likely(answer.probability)}</p>}
      {answer.verdict === "absent" && answer.searched.unnamed_things > 0 && (
        <p class="hint">{texts.ask.unnamed(answer.searched.unnamed_things)}</p>
      )}
    </div>
  );
}

function Objects({ answer, onFly }: { answer: Answer; onFly: Properties["onFly"] }) {
  const objects = answer.objects ?? [];
  if (objects.length === 0) return null;
  return (
    <>
      <h3>{texts.ask.objects}</h3>
      <ul class="chips">
        {objects.map((object, index) => (
          <li key={object.id}>
            <button
              type="button"
              class="chip"
              aria-label={texts.ask.flyTo(object.label, index + 1)}
              onClick={() => onFly(centerOf(object.box), boxSize(object.box))}
            >
              {object.label} {index + 1}
            </button>
          </li>
        ))}
      </ul>
    </>
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
