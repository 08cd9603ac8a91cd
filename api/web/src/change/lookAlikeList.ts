import type { SceneThing } from "../api/types";

const WORTH_ASKING = 0.3; // what is less likely is asked of nobody

/** Things without a name for which this one is suggested by the scene itself and not unlikely, the likeliest first. */
export function lookAlikes(
  things: readonly SceneThing[],
  name: string,
  declined: ReadonlySet<number> = new Set(),
): SceneThing[] {
  const likely = (thing: SceneThing) =>
    thing.suggestions.find((each) => each.name === name && !each.scene_id)?.probability ?? 0;
  const percent = (thing: SceneThing) => Math.round(100 * likely(thing)); // as it is shown
  return things
    .filter((thing) => name && !thing.name && !declined.has(thing.id) && likely(thing) >= WORTH_ASKING)
    .sort((a, b) => percent(b) - percent(a) || a.id - b.id);
}
