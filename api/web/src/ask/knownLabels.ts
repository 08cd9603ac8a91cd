import type { DictionaryEntry, SceneThing } from "../api/types";

/** The labels to offer as questions: those that something bears, or that are suggested for something without a name. */
export function knownLabels(
  entries: readonly DictionaryEntry[],
  things: readonly Pick<SceneThing, "name" | "suggestions">[] | null,
): string[] {
  const suggested = new Set(
    (things ?? []).flatMap((thing) => (thing.name ? [] : thing.suggestions.map((suggestion) => suggestion.name))),
  );
  const known = entries.filter((entry) => entry.gaussian_count > 0 || suggested.has(entry.label));
  return known.map((entry) => entry.label);
}
