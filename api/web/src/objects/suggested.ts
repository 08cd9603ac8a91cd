import type { Edit, SceneObject } from "../api/types";

type Suggestion = SceneObject["suggestions"][number];

const LIKELY = 0.8; // confirmed with others at once
const FILLED_IN = 0.5; // likelier than not: to take it costs less typing than to clear it
const AT_ONCE = 100; // edits that the server takes in one request

/** Who suggests a name, but for the scene's own models. */
export function othersSaying(suggestion: Suggestion): string[] {
  return suggestion.said_by.map((each) => each.source).filter((source) => source !== "detector");
}

/** What stands in the field for an object's name before anybody types: the likeliest name, or null. */
export function filledIn(object: SceneObject): Suggestion | null {
  const [first] = object.suggestions;
  return first && first.probability >= FILLED_IN ? first : null;
}

/** What gives an object a name, with the aliases that were suggested with it and those that were typed. */
export function naming(object: SceneObject, name: string, typed: readonly string[] = []): Partial<Edit> {
  const told = object.suggestions.find((each) => each.name === name)?.aliases ?? [];
  return { action: "name", object_ids: [object.id], name, aliases: [...told, ...typed] };
}

/** Names for the objects whose likeliest name is at least 80 % likely, as many as one request takes. */
export function likelyNames(objects: readonly SceneObject[]): Partial<Edit>[] {
  return objects
    .flatMap((object) => {
      const [first] = object.suggestions;
      return !object.name && first && first.probability >= LIKELY ? [naming(object, first.name)] : [];
    })
    .slice(0, AT_ONCE);
}
