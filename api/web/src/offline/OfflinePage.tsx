import { useEffect, useRef, useState } from "preact/hooks";

import type { SceneObject } from "../api/types";
import { KnownLabels, ObjectChips, QuestionForm, Verdict } from "../ask/askParts";
import { texts } from "../texts";
import { boxSize, centerOf } from "../viewer/boxes";
import { fromBase64, unpackBits } from "../viewer/states";
import type { OfflineAnswer, SceneData } from "./data";
import { nameOf, parameter, unzipped } from "./data";
import type { FlyTo } from "./OfflineViewer";
import { OfflineViewer } from "./OfflineViewer";

/** What the file says to a text: what the server had said of that name, or that only the server can tell. */
type Reply = { text: string; answer: OfflineAnswer | null };

/** A scene without its server: look at it, and ask for the names that it knows. */
export function OfflinePage({ data }: { data: SceneData }) {
  const [typed, setTyped] = useState(() => parameter("q"));
  const [reply, setReply] = useState<Reply | null>(() => replyTo(parameter("q"), data)); // nothing flies from its view
  const [found, setFound] = useState<Uint8Array | null>(null);
  const flyTo = useRef<FlyTo>(() => undefined);
  const answer = reply?.answer ?? null;

  const lookAt = ({ box, best_views: views }: SceneObject) =>
    box && flyTo.current({ middle: centerOf(box), size: boxSize(box), views });
  const ask = (text: string) => {
    const next = replyTo(text, data);
    setTyped(text);
    setReply(next);
    const [best] = next?.answer?.objects ?? [];
    if (best) lookAt(best);
  };
  useEffect(() => {
    let gone = false;
    if (!answer?.rows || answer.outcome === "not_here") setFound(null);
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
      <aside class="panel tab-body">
        <h1>{data.name || texts.scenes.untitled}</h1>
        <p class="hint">{texts.offline.about}</p>
        <section class="ask" aria-labelledby="ask-title">
          <h2 id="ask-title">{texts.ask.title}</h2>
          <QuestionForm text={typed} onType={setTyped} onAsk={() => ask(typed)} />
          <div aria-live="polite">
            {reply && (reply.answer ? <Verdict answer={reply.answer} /> : <Unknown text={reply.text} />)}
          </div>
          {answer && <ObjectChips objects={answer.objects} onFly={lookAt} />}
          <KnownLabels labels={data.labels} onAsk={ask} />
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

function Unknown({ text }: { text: string }) {
  return (
    <div class="verdict">
      <p class="verdict-word">{texts.offline.unknown}</p>
      <p>{texts.offline.unknownText(text)}</p>
    </div>
  );
}
