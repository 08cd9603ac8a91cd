import { useEffect } from "preact/hooks";

import { isShared } from "../address/share";
import { beginRuler } from "../change/ruler";
import { typing, undoKeys } from "../change/shortcuts";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import type { IconName } from "../ui/Icon";
import { Icon } from "../ui/Icon";
import type { Mode } from "../viewer/colors";
import { MODES } from "../viewer/colors";

/** Beside the picture and never over it: where to go back to, what the colors show, the ruler, undo and redo. */
export function Toolbar({ state, onHome }: { state: SceneState; onHome: () => void }) {
  useEffect(() => (isShared ? undefined : undoKeys(state)), [state]);
  useEffect(() => askKey(state), [state]);
  return (
    <div class="toolbar" role="group" aria-label={texts.scene.tools}>
      <Tool icon="home" text={texts.scene.home} onClick={onHome} />
      <label class="tool-colors">
        <Icon name="colors" />
        <span class="sr-only">{texts.look.colors}</span>
        <select
          value={state.look.mode.value}
          onChange={(event) => state.look.setMode(event.currentTarget.value as Mode)}
        >
          {MODES.map((mode) => (
            <option key={mode} value={mode}>
              {texts.look.modes[mode]}
            </option>
          ))}
        </select>
      </label>
      {!isShared && <Tool icon="measure" text={texts.change.measure} onClick={() => beginRuler(state)} />}
      <details>
        <summary title={texts.scene.help}>
          <Icon name="help" />
          <span class="tool-label">{texts.scene.help}</span>
        </summary>
        <div class="tool-help">
          <p id="canvas-help">{texts.scene.canvasHelp}</p>
          <p>{texts.scene.walkHelp}</p>
        </div>
      </details>
      {!isShared && (
        <span class="tool-end">
          <Tool
            icon="undo"
            text={texts.objects.undo}
            disabled={!state.canUndo.value || state.busy.value}
            onClick={() => void state.undo(texts.objects.undone)}
          />
          <Tool
            icon="redo"
            text={texts.change.redo}
            disabled={!state.canRedo.value || state.busy.value}
            onClick={() => void state.redo(texts.change.redone)}
          />
        </span>
      )}
    </div>
  );
}

function Tool({
  icon,
  text,
  disabled = false,
  onClick,
}: {
  icon: IconName;
  text: string;
  disabled?: boolean;
  onClick: () => void;
}) {
  return (
    <button type="button" class="tool" title={text} disabled={disabled} onClick={onClick}>
      <Icon name={icon} />
      <span class="tool-label">{text}</span>
    </button>
  );
}

/** `/` leads to the question, wherever the focus is but in a field; returns what ends it. */
function askKey(state: SceneState): () => void {
  const ended = new AbortController();
  document.addEventListener(
    "keydown",
    (event) => {
      if (event.key !== "/" || event.ctrlKey || event.altKey || event.metaKey || typing(event)) return;
      event.preventDefault();
      state.tab.value = "ask";
      // The field is in sight once that tab is drawn.
      requestAnimationFrame(() => document.querySelector<HTMLInputElement>("#question")?.select());
    },
    { signal: ended.signal },
  );
  return () => ended.abort();
}
