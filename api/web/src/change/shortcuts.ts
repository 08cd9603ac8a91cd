import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";

/** Whether a key is for the field that has the focus, which undoes its own typing. */
export function typing(event: KeyboardEvent): boolean {
  const target = event.target;
  return target instanceof HTMLElement && target.matches("input:not([type=checkbox]), textarea, select");
}

/** Ctrl+Z, and Ctrl+Shift+Z or Ctrl+Y, wherever the focus is but in a field; returns what ends it. */
export function undoKeys(state: SceneState): () => void {
  const ended = new AbortController();
  document.addEventListener(
    "keydown",
    (event) => {
      if (!(event.ctrlKey || event.metaKey) || event.altKey || typing(event)) return;
      const key = event.key.toLowerCase();
      const redo = key === "y" || (key === "z" && event.shiftKey);
      if (!redo && key !== "z") return;
      event.preventDefault();
      if (state.busy.value) return;
      if (redo && state.canRedo.value) void state.redo(texts.change.redone);
      if (!redo && state.canUndo.value) void state.undo(texts.objects.undone);
    },
    { signal: ended.signal },
  );
  return () => ended.abort();
}
