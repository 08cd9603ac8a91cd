import type { PromptTool, SeenPlace } from "../state/changeState";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";

/** Begins to take clicks; until the person ends it, a click says where the object is. */
export function beginPrompt(state: SceneState, kind: PromptTool["kind"], object = 0): void {
  const { change } = state;
  change.ruler.value = null;
  change.prompt.value = { kind, object, made: null, places: [] };
  change.onPlace.value = (place) => void promptAt(state, place);
}

export function endPrompt(state: SceneState): void {
  state.change.prompt.value = null;
  state.change.onPlace.value = null;
}

/** What the next request says: from one viewpoint all clicks count, from another one only those made there. */
export function promptOf(places: readonly SeenPlace[]) {
  const last = places.at(-1);
  if (!last) return null;
  const camera = JSON.stringify(last.camera);
  const pixels = places.filter((place) => JSON.stringify(place.camera) === camera).map((place) => place.pixel);
  return { camera: last.camera, view: null, pixels, background: [], box: null };
}

/** Makes the object at a place, in place of the one that earlier clicks made. */
async function promptAt(state: SceneState, place: SeenPlace): Promise<void> {
  const { change } = state;
  const tool = change.prompt.value;
  if (!tool || state.busy.value) return;
  const places = [...tool.places, place];
  const stillThere = tool.made && tool.made.version === state.version.value;
  if (stillThere && !(await state.undo(""))) return;
  const prompt = promptOf(places);
  if (!prompt) return;
  const objects = tool.kind === "split" ? [tool.object] : [];
  const done = await state.edit({ action: tool.kind, object_ids: objects, prompt }, texts.change.promptDone);
  const new_ = state.made.value?.prompted[0];
  if (change.prompt.value?.kind !== tool.kind) return; // ended meanwhile
  if (!done || !new_) {
    change.prompt.value = { ...tool, made: null, places: tool.places };
    return;
  }
  const made = { id: new_.object_id, count: new_.gaussian_count, version: state.version.value };
  state.select(new_.object_id);
  change.prompt.value = { ...tool, made, places };
}
