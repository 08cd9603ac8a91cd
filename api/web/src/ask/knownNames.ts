import type { SceneObject } from "../api/types";

/** The names to offer as questions: those that objects bear, then those that are suggested for some, the likeliest first. */
export function knownNames(objects: readonly Pick<SceneObject, "name" | "suggestions">[]): string[] {
  const borne = objects.flatMap((object) => (object.name ? [object.name] : []));
  const suggested = objects
    .flatMap((object) => object.suggestions)
    .sort((one, other) => other.probability - one.probability);
  return [...new Set([...borne, ...suggested.map((suggestion) => suggestion.name)])];
}
