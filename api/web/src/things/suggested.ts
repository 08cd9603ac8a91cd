import type { Edit, SceneThing } from "../api/types";

type Suggestion = SceneThing["suggestions"][number];

const LIKELY = 0.8; // confirmed with others at once
const FILLED_IN = 0.5; // likelier than not: to take it costs less typing than to clear it
const AT_ONCE = 100; // edits that the server takes in one request

/** Who suggests a name, but for the scene's own models. */
export function othersSaying(suggestion: Suggestion): string[] {
  return suggestion.said_by.map((each) => each.source).filter((source) => source !== "detector");
}

/** What stands in the field for a thing's name before anybody types: the likeliest name, or null. */
export function filledIn(thing: SceneThing): Suggestion | null {
  const [first] = thing.suggestions;
  return first && first.probability >= FILLED_IN ? first : null;
}

/** What gives a thing a name, with the aliases that were suggested with it and those that were typed. */
export function naming(thing: SceneThing, name: string, typed: readonly string[] = []): Partial<Edit> {
  const told = thing.suggestions.find((each) => each.name === name)?.aliases ?? [];
  return { action: "name", thing_ids: [thing.id], name, aliases: [...told, ...typed] };
}

/** Names for the things whose likeliest name is at least 80 % likely, as many as one request takes. */
export function likelyNames(things: readonly SceneThing[]): Partial<Edit>[] {
  return things
    .flatMap((thing) => {
      const [first] = thing.suggestions;
      return !thing.name && first && first.probability >= LIKELY ? [naming(thing, first.name)] : [];
    })
    .slice(0, AT_ONCE);
}
