import type { SceneObject } from "../api/types";

const OFFERED = 0.8; // a less likely name is a suggestion among others, and no question

/** Objects without a name for which this one is suggested by the scene itself and likely, the likeliest first. */
export function lookAlikes(
  objects: readonly SceneObject[],
  name: string,
  declined: ReadonlySet<number> = new Set(),
): SceneObject[] {
  const likely = (object: SceneObject) =>
    object.suggestions.find((each) => each.name === name && !each.scene_id)?.probability ?? 0;
  const percent = (object: SceneObject) => Math.round(100 * likely(object)); // as it is shown
  return objects
    .filter((object) => name && !object.name && !declined.has(object.id) && likely(object) >= OFFERED)
    .sort((a, b) => percent(b) - percent(a) || a.id - b.id);
}
