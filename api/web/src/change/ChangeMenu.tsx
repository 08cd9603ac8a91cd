import { useEffect, useRef, useState } from "preact/hooks";

import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { ErrorNote } from "../ui/parts";
import { centerOf } from "../viewer/boxes";
import { beginPrompt } from "./prompts";
import { beginRuler } from "./ruler";

/** What can be done to the selected things: hidden and isolated on show; recolored, moved, copied, removed as versions. */
export function ChangeMenu({ state }: { state: SceneState }) {
  const { change } = state;
  useEffect(
    () => state.selected.subscribe(() => (change.motion.value = null)), // it was of those that were selected before
    [state, change],
  );
  const menu = useRef<HTMLDetailsElement>(null);
  const close = () => menu.current && (menu.current.open = false);
  const things = state.selectedThings.value;
  const ids = things.map((thing) => thing.id);
  const box = things.find((thing) => thing.box)?.box;
  return (
    <details class="change-menu" ref={menu}>
      <summary>{texts.change.title}</summary>
      <div class="change-body">
        {things.length === 0 && <p class="hint">{texts.change.selectFirst}</p>}
        {state.actionError.value !== null && <ErrorNote error={state.actionError.value} />}
        {things.length > 0 && (
          <>
            <div class="buttons">
              <button type="button" onClick={() => change.hide(ids)}>
                {texts.change.hide}
              </button>
              <button type="button" onClick={() => change.isolate(ids)}>
                {texts.change.isolate}
              </button>
              {box && (
                <button
                  type="button"
                  onClick={() => {
                    change.motion.value = { pivot: centerOf(box), shift: [0, 0, 0], angles: [0, 0, 0] };
                    close();
                  }}
                >
                  {texts.change.moveOrTurn}
                </button>
              )}
              <button
                type="button"
                class="danger"
                disabled={state.busy.value}
                onClick={() => void state.edit({ action: "remove", things: ids }, texts.change.removed)}
              >
                {texts.change.remove}
              </button>
            </div>
            <Recolor state={state} ids={ids} />
          </>
        )}
        <div class="buttons">
          {things.length === 1 && (
            <button
              type="button"
              disabled={state.busy.value}
              onClick={() => {
                beginPrompt(state, "split", ids[0]);
                close();
              }}
            >
              {texts.change.split}
            </button>
          )}
          <button
            type="button"
            disabled={state.busy.value}
            onClick={() => {
              beginPrompt(state, "add");
              close();
            }}
          >
            {texts.change.add}
          </button>
          <button
            type="button"
            onClick={() => {
              beginRuler(state);
              close();
            }}
          >
            {texts.change.measure}
          </button>
          {change.hides.value && (
            <button type="button" onClick={() => change.showAll()}>
              {texts.change.showAll}
            </button>
          )}
        </div>
      </div>
    </details>
  );
}

function Recolor({ state, ids }: { state: SceneState; ids: number[] }) {
  const [color, setColor] = useState("#3d7be0");
  const [r = 0, g = 0, b = 0] = [1, 3, 5].map((at) => parseInt(color.slice(at, at + 2), 16) / 255);
  return (
    <form
      class="recolor"
      onSubmit={(event) => {
        event.preventDefault();
        void state.edit({ action: "recolor", things: ids, color: { r, g, b } }, texts.change.recolored);
      }}
    >
      <label>
        {texts.change.color}
        <input type="color" value={color} onInput={(event) => setColor(event.currentTarget.value)} />
      </label>
      <button disabled={state.busy.value}>{texts.change.recolor}</button>
    </form>
  );
}
