import { useEffect, useState } from "preact/hooks";

import type { SceneState } from "../state/sceneState";
import { followOperation } from "./followOperation";

/** Follows an unready scene's job while the page is in sight; reloads the scene with each draft and at the end. */
export function useJob(state: SceneState, watched: boolean): void {
  const scene = state.scene.value;
  const operationId = watched && scene && scene.state !== "READY" ? scene.operation_id : "";
  const done = state.operation.value?.done ?? false;
  const visible = useVisible(); // a browser opens few connections to a server: tabs in the background leave theirs
  useEffect(() => {
    if (!operationId || done || !visible) return;
    const controller = new AbortController();
    let drafts = 0;
    followOperation(operationId, controller.signal, (operation) => {
      if (controller.signal.aborted) return;
      state.operation.value = operation;
      const newer = (operation.draft?.number ?? 0) > drafts;
      drafts = operation.draft?.number ?? 0;
      if (operation.done || newer) void state.refresh();
    }).catch(() => void state.refresh()); // deleted meanwhile: the scene says so
    return () => controller.abort();
  }, [state, operationId, done, visible]);
}

function useVisible(): boolean {
  const [visible, setVisible] = useState(!document.hidden);
  useEffect(() => {
    const look = () => setVisible(!document.hidden);
    document.addEventListener("visibilitychange", look);
    return () => document.removeEventListener("visibilitychange", look);
  }, []);
  return visible;
}
