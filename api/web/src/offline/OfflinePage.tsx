import { useEffect, useRef, useState } from "preact/hooks";

import type { SceneObject } from "../api/types";
import { texts } from "../texts";
import { boxSize, centerOf } from "../viewer/boxes";
import type { LookAt } from "../viewer/poses";
import { lookAtBox } from "../viewer/poses";
import { fromBase64, unpackBits } from "../viewer/states";
import type { OfflineAnswer, SceneData } from "./data";
import { nameOf, parameter, unzipped } from "./data";
import { OfflineViewer } from "./OfflineViewer";

/** What the file says to a text: what the server had said of that name, or that only the server can tell. */
type Reply = { text: string; answer: OfflineAnswer | null };

/** A scene without its server: look at it, and ask for the names that it knows. */
export function OfflinePage({ data }: { data: SceneData }) {
  const [typed, setTyped] = useState(() => parameter("q"));
  const [reply, setReply] = useState<Reply | null>(() => replyTo(parameter("q"), data)); // nothing flies from its view
  const [found, setFound] = useState<Uint8Array | null>(null);
  const flyTo = useRef<(aim: (now: LookAt) => LookAt) => void>(() => undefined);
  const answer = reply?.answer ?? null;

  const lookAt = (object: SceneObject) =>
    flyTo.current((now) => lookAtBox(now, centerOf(object.box), boxSize(object.box)));
  const ask = (text: string) => {
    const next = replyTo(text, data);
    setTyped(text);
    setReply(next);
    const [best] = next?.answer?.objects ?? [];
    if (best) lookAt(best);
  };
  useEffect(() => {
    let gone = false;
    if (!answer?.rows || answer.verdict === "absent") setFound(null);
    else
      void unzipped(fromBase64(answer.rows)).then((bits) => {
        if (!gone) setFound(unpackBits(bits, data.gaussians));
      });
    return () => {
      gone = true;
    };
  }, [answer, data]);

  return (
    <main class="scene offline-scene">
      <OfflineViewer data={data} found={found} flyTo={flyTo} />
      <aside class="panel">
        <h1>{data.name || texts.scenes.untitled}</h1>
        <p class="hint">{texts.offline.about}</p>
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
              autocomplete="off"
              onInput={(event) => setTyped(event.currentTarget.value)}
            />
            <button class="primary">{texts.ask.title}</button>
          </form>
          <div aria-live="polite">{reply && <Verdict reply={reply} />}</div>
          {answer && answer.objects.length > 0 && (
            <>
              <h3>{texts.ask.objects}</h3>
              <ul class="chips">
                {answer.objects.map((object, index) => (
                  <li key={object.id}>
                    <button
                      type="button"
                      class="chip"
                      aria-label={texts.ask.flyTo(object.label, index + 1)}
                      onClick={() => lookAt(object)}
                    >
                      {object.label} {index + 1}
                    </button>
                  </li>
                ))}
              </ul>
            </>
          )}
          <h3>{texts.ask.knownLabels}</h3>
          <ul class="chips">
            {data.labels.map((label) => (
              <li key={label}>
                <button type="button" class="chip" onClick={() => ask(label)}>
                  {label}
                </button>
              </li>
            ))}
          </ul>
          {data.left_out > 0 && <p class="hint">{texts.offline.leftOut(data.left_out)}</p>}
        </section>
      </aside>
    </main>
  );
}

function replyTo(text: string, data: SceneData): Reply | null {
  const name = nameOf(text, data.names);
  return text.trim() ? { text: text.trim(), answer: name ? (data.answers[name.answer] ?? null) : null } : null;
}

function Verdict({ reply: { text, answer } }: { reply: Reply }) {
  if (!answer)
    return (
      <div class="verdict">
        <p class="verdict-word">{texts.offline.unknown}</p>
        <p>{texts.offline.unknownText(text)}</p>
      </div>
    );
  return (
    <div class={`verdict ${answer.verdict}`}>
      <p class="verdict-word">{texts.ask.verdicts[answer.verdict]}</p>
      <p>{answer.explanation}</p>
      {answer.probability !== null && <p class="hint">{texts.ask.likely(answer.probability)}</p>}
    </div>
  );
}
