import type { SceneThing } from "../api/types";

/** The names to offer as questions: those that things bear, then those that are suggested for some, the likeliest first. */
export function knownNames(things: readonly Pick<SceneThing, "name" | "suggestions">[]): string[] {
  const borne = things.flatMap((thing) => (thing.name ? [thing.name] : []));
  const suggested = things
    .flatMap((thing) => thing.suggestions)
    .sort((one, other) => other.probability - one.probability);
  return [...new Set([...borne, ...suggested.map((suggestion) => suggestion.name)])];
}
