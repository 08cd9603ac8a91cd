import { sceneAddress } from "../address/router";
import { listScenes } from "../api/calls";
import type { SceneSummary } from "../api/types";
import { Progress } from "../jobs/Progress";
import { texts } from "../texts";
import { ErrorNote, Loading } from "../ui/parts";
import { useLoaded } from "../ui/useLoaded";
import { Thumbnail } from "./Thumbnail";

const BUSY_MS = 3_000;
const QUIET_MS = 15_000;

/** Every scene of the project, with a picture and its state. */
export function ScenesPage() {
  const { value, error, reload } = useLoaded(listScenes, [], (scenes) =>
    scenes?.some((scene) => scene.state === "TRAINING") ? BUSY_MS : QUIET_MS,
  );
  return (
    <section class="scenes" aria-labelledby="scenes-title">
      <div class="title-row">
        <h1 id="scenes-title">{texts.scenes.title}</h1>
        <a class="button primary" href="#/new">
          {texts.nav.newScene}
        </a>
      </div>
      {error !== null && <ErrorNote error={error} onRetry={reload} />}
      {value === null && error === null && <Loading />}
      {value?.length === 0 && (
        <div class="empty">
          <p>{texts.scenes.empty}</p>
          <p class="hint">{texts.scenes.emptyHint}</p>
        </div>
      )}
      {value !== null && value.length > 0 && (
        <ul class="cards">
          {value.map((scene) => (
            <li key={scene.id}>
              <Card scene={scene} />
            </li>
          ))}
        </ul>
      )}
    </section>
  );
}

function Card({ scene }: { scene: SceneSummary }) {
  const name = scene.name || texts.scenes.untitled;
  return (
    <a class="card" href={sceneAddress(scene.id)}>
      <Thumbnail scene={scene} name={name} />
      <span class="card-name">{name}</span>
      <span class={`state ${scene.state.toLowerCase()}`}>{texts.scenes.states[scene.state]}</span>
      {scene.state === "READY" && <span class="hint">{texts.scenes.gaussians(scene.gaussians)}</span>}
      {scene.state === "TRAINING" && <Progress operationId={scene.operation_id} />}
    </a>
  );
}
