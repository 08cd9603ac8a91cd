import * as calls from "../api/calls";
import { isAbort } from "../api/http";
import type { Place } from "../api/types";
import type { RulerTool, SeenPlace } from "../state/changeState";
import type { SceneState } from "../state/sceneState";

const EMPTY: RulerTool = { places: [], measured: null, error: null, waiting: false };

export function beginRuler(state: SceneState): void {
  state.change.prompt.value = null;
  state.change.ruler.value = EMPTY;
  state.change.onPlace.value = (place) => void addPlace(state, placeOf(place));
}

export function endRuler(state: SceneState): void {
  state.change.ruler.value = null;
  state.change.onPlace.value = null;
}

/** A third place begins anew. */
export async function addPlace(state: SceneState, place: Place): Promise<void> {
  const ruler = state.change.ruler.value;
  if (!ruler || ruler.waiting) return;
  await measure(state, ruler.places.length === 1 ? [...ruler.places, place] : [place]);
}

/** Asks for these places; a place that is none is left out again, and the error says why. */
export async function measure(state: SceneState, places: readonly Place[]): Promise<void> {
  const { change } = state;
  const before = change.ruler.value ?? EMPTY;
  change.ruler.value = { ...before, error: null, waiting: true };
  try {
    const measured = await calls.measure(state.sceneId, state.version.value, places);
    if (change.ruler.peek()) change.ruler.value = { places, measured, error: null, waiting: false };
  } catch (error) {
    if (change.ruler.peek() && !isAbort(error)) change.ruler.value = { ...before, error, waiting: false };
  }
}

function placeOf({ camera, pixel }: SeenPlace): Place {
  return { camera, pixel, view: null, point: null, object_id: null };
}
