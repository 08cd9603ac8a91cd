import { useState } from "preact/hooks";

import { sceneAddress } from "../address/router";
import { alignTo, listCaptures, listScenes } from "../api/calls";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { dayText } from "../texts/figures";
import { ErrorNote, Loading } from "../ui/parts";
import { useLoaded } from "../ui/useLoaded";
import "./improve.css";

/** The captures of a scene's place by date, to switch between, and how the scene becomes one of another one's. */
export function Captures({ state }: { state: SceneState }) {
  const [open, setOpen] = useState(false);
  return (
    <details class="improve" onToggle={(event) => setOpen(event.currentTarget.open)}>
      <summary>{texts.captures.title}</summary>
      {open && <OfPlace state={state} />}
    </details>
  );
}

function OfPlace({ state }: { state: SceneState }) {
  const { sceneId } = state;
  const [other, setOther] = useState("");
  const { value, error } = useLoaded(
    async () => ({ captures: await listCaptures(sceneId), scenes: await listScenes() }),
    [sceneId, state.version.value],
  );
  if (!value) return error === null ? <Loading /> : <ErrorNote error={error} />;
  const here = new Set(value.captures.map((each) => each.id));
  const others = value.scenes.filter((each) => each.state === "READY" && !here.has(each.id));
  return (
    <>
      <p class="hint">{texts.captures.help}</p>
      {value.captures.length > 1 && (
        <ol class="captures" aria-label={texts.captures.list}>
          {value.captures.map((each) => {
            const name = texts.captures.of(dayText(each.captured_at ?? each.created_at), each.name);
            return (
              <li key={each.id}>
                {each.id === sceneId ? (
                  <span aria-current="page">
                    {name} ({texts.captures.shown})
                  </span>
                ) : (
                  <a href={sceneAddress(each.id)}>{name}</a>
                )}
              </li>
            );
          })}
        </ol>
      )}
      {state.isCurrent.value &&
        (others.length === 0 ? (
          value.captures.length === 1 && <p>{texts.captures.none}</p>
        ) : (
          <form
            onSubmit={(event) => {
              event.preventDefault();
              void state.make(() => alignTo(sceneId, other), texts.captures.aligned);
            }}
          >
            <label>
              {texts.captures.other}
              <select value={other} onChange={(event) => setOther(event.currentTarget.value)}>
                <option value="">{texts.captures.choose}</option>
                {others.map((each) => (
                  <option key={each.id} value={each.id}>
                    {texts.captures.of(dayText(each.captured_at ?? each.created_at), each.name)}
                  </option>
                ))}
              </select>
            </label>
            <button type="submit" disabled={!other || state.busy.value}>
              {texts.captures.submit}
            </button>
          </form>
        ))}
      {state.busy.value && <Loading />}
    </>
  );
}
