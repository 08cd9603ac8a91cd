import { useState } from "preact/hooks";

import { go, sceneAddress } from "../address/router";
import { deleteScene, listScenes, openSample } from "../api/calls";
import type { SceneSummary } from "../api/types";
import { Progress } from "../jobs/Progress";
import { texts } from "../texts";
import { dayText } from "../texts/figures";
import { Button } from "../ui/Button";
import { DeleteButton } from "../ui/DeleteButton";
import { Form } from "../ui/fields";
import { ErrorNote, Loading } from "../ui/parts";
import { useLoaded } from "../ui/useLoaded";
import type { Order } from "./arranged";
import { arranged, ORDERS } from "./arranged";
import type { Told } from "./Thumbnail";
import { Thumbnail } from "./Thumbnail";
import { WhereIs } from "./WhereIs";

const BUSY_MS = 3_000;
const QUIET_MS = 15_000;

/** Every scene of the project, with a photo and its state; found by name, or by the objects in it. */
export function ScenesPage() {
  const { value, error, reload } = useLoaded(listScenes, [], (scenes) =>
    scenes?.some((scene) => scene.state === "TRAINING") ? BUSY_MS : QUIET_MS,
  );
  const [text, setText] = useState("");
  const [asked, setAsked] = useState("");
  const [order, setOrder] = useState<Order>("newest");
  /** Ids of the scenes that are selected; null: none are to be. */
  const [picked, setPicked] = useState<readonly string[] | null>(null);
  const some = value !== null && value.length > 0;
  const chosen = value?.filter(({ id }) => picked?.includes(id)) ?? [];
  const listed = arranged(value ?? [], asked ? "" : text, order);
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
          <OpenSample />
        </div>
      )}
      {some && (
        <Form role="search" class="find-scenes" onSubmit={() => setAsked(text.trim())}>
          <label class="sr-only" for="find">
            {texts.scenes.find}
          </label>
          <input
            id="find"
            type="search"
            value={text}
            maxLength={1000}
            placeholder={texts.scenes.findExample}
            autocomplete="off"
            onInput={(event) => {
              setText(event.currentTarget.value);
              setAsked("");
            }}
          />
          <Button type="submit" disabled={!text.trim()} text={texts.scenes.askAll} />
          <label class="sort">
            <span class="sr-only">{texts.scenes.sort}</span>
            <select value={order} onChange={(event) => setOrder(event.currentTarget.value as Order)}>
              {ORDERS.map((name) => (
                <option key={name} value={name}>
                  {texts.scenes.orders[name]}
                </option>
              ))}
            </select>
          </label>
          <Button
            aria-pressed={picked !== null}
            onClick={() => setPicked((before) => (before === null ? [] : null))}
            text={picked === null ? texts.scenes.select : texts.scenes.selectDone}
          />
        </Form>
      )}
      {picked !== null && chosen.length > 0 && (
        <DeleteButton
          key={picked.join()}
          label={texts.scenes.removeSelected(chosen.length)}
          question={texts.scenes.removeQuestion(chosen.map(nameOf))}
          onDelete={async () => {
            for (const { id } of chosen) await deleteScene(id).finally(reload);
            setPicked(null);
          }}
        />
      )}
      {asked && value && <WhereIs key={asked} text={asked} scenes={value} />}
      {some && listed.length === 0 && <p class="hint">{texts.scenes.noneNamed(text.trim())}</p>}
      {listed.length > 0 && (
        <ul class="cards" aria-label={texts.scenes.title}>
          {listed.map((scene) => (
            <li key={scene.id} class="card-place">
              <Card scene={scene} />
              {picked !== null && (
                <input
                  type="checkbox"
                  aria-label={texts.scenes.selectOne(nameOf(scene))}
                  checked={picked.includes(scene.id)}
                  onChange={(event) => {
                    const others = picked.filter((id) => id !== scene.id);
                    setPicked(event.currentTarget.checked ? [...others, scene.id] : others);
                  }}
                />
              )}
            </li>
          ))}
        </ul>
      )}
    </section>
  );
}

const nameOf = (scene: SceneSummary): string => scene.name || texts.scenes.untitled;

function OpenSample() {
  const [busy, setBusy] = useState(false);
  const [error, setError] = useState<unknown>(null);
  const open = () => {
    setBusy(true);
    setError(null);
    openSample()
      .then(({ id }) => go(sceneAddress(id)), setError)
      .finally(() => setBusy(false));
  };
  return (
    <>
      <Button class="primary" disabled={busy} onClick={open} text={texts.scenes.openSample} />
      {error !== null && <ErrorNote error={error} />}
    </>
  );
}

function Card({ scene }: { scene: SceneSummary }) {
  const [told, setTold] = useState<Told | null>(null);
  const grade = told?.grade;
  const name = nameOf(scene);
  const ready = scene.state === "READY";
  const made = dayText(scene.created_at);
  return (
    <a class="card" href={sceneAddress(scene.id)}>
      <Thumbnail scene={scene} name={name} onLoaded={setTold} />
      <span class="card-name">{name}</span>
      <span class={`state ${scene.state.toLowerCase()} ${grade ?? ""}`}>
        {ready && grade ? texts.scenes.grades[grade] : texts.scenes.states[scene.state]}
      </span>
      {ready && (
        <span class="hint names">
          {texts.scenes.objects(told?.objects ?? scene.object_count ?? null, told?.names ?? [])}
        </span>
      )}
      <span class="hint">{[ready && texts.scenes.gaussians(scene.gaussians), made].filter(Boolean).join(" · ")}</span>
      {scene.state === "TRAINING" && <Progress operationId={scene.operation_id} />}
    </a>
  );
}
