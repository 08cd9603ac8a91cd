import type { Signal } from "@preact/signals";
import { useSignalEffect } from "@preact/signals";

import type { SceneState } from "../state/sceneState";
import type { ServerView } from "./ServerView";

/** Keeps a view that the server draws up to date with what is found, pointed at and selected. */
export function useServerView(view: Signal<ServerView | null>, state: SceneState): void {
  useSignalEffect(() => {
    const version = state.version.value;
    // Objects of the version before may be gone in this one: the server would refuse to draw them.
    const listed = state.objectsVersion.value === version ? state.objects.value : null;
    const known = listed && [...listed, ...state.parts.value].map((object) => object.id);
    if (!view.value || !version) return;
    const answer = state.answer.value;
    const lit = state.lit.value;
    const found =
      lit === "answer" && answer?.version === version && answer.object_ids.length > 0 ? answer.object_ids : null;
    const selected = lit === "selection" ? state.selected.value.filter((id) => known?.includes(id)) : [];
    view.value.show({
      version,
      found: found ?? [],
      dimmed: found !== null || selected.length > 0,
      hovered: known?.includes(state.hovered.value) ? state.hovered.value : 0,
      selected,
    });
  });
}
