import { useEffect, useState } from "preact/hooks";

import { sceneAddress } from "../address/router";
import { askEveryScene } from "../api/calls";
import { listPhotos, photoAddress } from "../api/photoCalls";
import type { Answer, SceneSummary } from "../api/types";
import { texts } from "../texts";
import { Icon } from "../ui/Icon";
import { ErrorNote, Loading } from "../ui/parts";
import { useLoaded } from "../ui/useLoaded";

/** In which scenes something is: for each that has it, a picture that shows it best, and the way there. */
export function WhereIs({ text, scenes }: { text: string; scenes: readonly SceneSummary[] }) {
  const { value, error, reload } = useLoaded((signal) => askEveryScene(text, signal), [text]);
  if (error !== null) return <ErrorNote error={error} onRetry={reload} />;
  if (value === null) return <Loading />;
  const found = value
    .filter(({ outcome }) => outcome === "here" || outcome === "probably_here")
    .sort((one, other) => Number(one.outcome !== "here") - Number(other.outcome !== "here") || sure(other) - sure(one));
  return (
    <section class="where-is" aria-labelledby="where-title">
      <div role="status">
        <h2 id="where-title">{texts.scenes.foundIn(text, found.length, value.length)}</h2>
      </div>
      <ul class="cards">
        {found.map((answer) => (
          <li key={answer.scene_id}>
            <a class="card" href={sceneAddress(answer.scene_id, { text })}>
              <BestPicture answer={answer} />
              <span class="card-name">
                {scenes.find(({ id }) => id === answer.scene_id)?.name || texts.scenes.untitled}
              </span>
              <span class="hint">{answer.sentence}</span>
            </a>
          </li>
        ))}
      </ul>
    </section>
  );
}

const sure = (answer: Answer): number => answer.probability ?? answer.presence ?? 0;

function BestPicture({ answer }: { answer: Answer }) {
  const [address, setAddress] = useState("");
  const view = answer.objects?.[0]?.best_views[0];
  const { scene_id: sceneId, version } = answer;
  useEffect(() => {
    if (!view) return;
    const controller = new AbortController();
    const { signal } = controller;
    listPhotos(sceneId, version, signal)
      .then((stored) => photoAddress(sceneId, version, view, stored.has(view)))
      .then(
        (loaded) => !signal.aborted && setAddress(loaded),
        () => undefined, // the card says where it is without a picture
      );
    return () => controller.abort();
  }, [sceneId, version, view]);
  return <span class="thumbnail">{address ? <img src={address} alt="" /> : <Icon name="photos" />}</span>;
}
