import { useState } from "preact/hooks";

import { listObservations, observe } from "../api/photoCalls";
import type { Observation } from "../api/types";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { momentText } from "../texts/figures";
import { Button } from "../ui/Button";
import { ErrorNote, Loading } from "../ui/parts";
import { useLoaded } from "../ui/useLoaded";
import { ChangePictures } from "./ChangePictures";
import "./improve.css";

interface Props {
  state: SceneState;
}

/** Photos of another day compared with the scene: what is gone, moved, new or changed, kept with it until undone. */
export function CompareToday({ state }: Props) {
  const [open, setOpen] = useState(false);
  return (
    <details class="improve" onToggle={(event) => setOpen(event.currentTarget.open)}>
      <summary>{texts.observe.title}</summary>
      {open && <Comparing state={state} />}
    </details>
  );
}

function Comparing({ state }: Props) {
  const { sceneId } = state;
  const version = state.version.value;
  const { value, error } = useLoaded((signal) => listObservations(sceneId, version, signal), [sceneId, version]);
  const [photos, setPhotos] = useState<readonly File[]>([]);
  const [comparing, setComparing] = useState(false);
  const compare = async (event: Event) => {
    event.preventDefault();
    setComparing(true);
    await state.make(() => observe(sceneId, photos), texts.observe.kept(photos.length));
    setComparing(false);
  };
  return (
    <>
      <p class="hint">{texts.observe.help}</p>
      {state.isCurrent.value && (
        <form onSubmit={(event) => void compare(event)}>
          <label>
            {texts.observe.choose}
            <input
              type="file"
              accept="image/*"
              multiple
              onChange={(event) => setPhotos([...(event.currentTarget.files ?? [])])}
            />
          </label>
          <button type="submit" disabled={photos.length < 2 || state.busy.value}>
            {texts.observe.submit}
          </button>
        </form>
      )}
      {comparing && <Loading />}
      {error !== null && <ErrorNote error={error} />}
      {value && value.length > 0 && (
        <ol class="observations">
          {value.map((each) => (
            <Told key={each.id} state={state} observation={each} />
          ))}
        </ol>
      )}
    </>
  );
}

function Told({ state, observation }: Props & { observation: Observation }) {
  const made = state.versions.value.find((each) => each.version === observation.id);
  const when = momentText(observation.seen_at);
  return (
    <li>
      <h3>{texts.observe.day(when, observation.photos.length)}</h3>
      {observation.changes.length === 0 && <p>{observation.sentence}</p>}
      {observation.left_out.map((why) => (
        <p class="hint" key={why}>
          {texts.observe.leftOut(why)}
        </p>
      ))}
      <ul>
        {observation.changes.map((change, number) => (
          <li key={number}>
            <p>{change.sentence}</p>
            <ChangePictures
              sceneId={state.sceneId}
              version={state.version.value}
              observation={observation}
              change={change}
            />
            {change.object_id > 0 && (
              <Button
                aria-pressed={state.lit.value === "selection" && state.selected.value.includes(change.object_id)}
                onClick={() => state.glow(change.object_id)}
                text={texts.observe.show}
              />
            )}
          </li>
        ))}
      </ul>
      {made?.current && state.isCurrent.value && (
        <Button
          disabled={state.busy.value}
          onClick={() => void state.undo(texts.observe.undone)}
          text={texts.observe.undo}
        />
      )}
    </li>
  );
}
