import type { Edit, SceneVersion } from "../api/types";
import { texts } from "../texts";

/** What made a version, in a few words: the edits in their order, equal ones once. */
export function describeVersion(version: SceneVersion): string {
  if (!version.parent && version.edits.length === 0) return texts.change.trained;
  return [...new Set(version.edits.map(describeEdit))].join(", ");
}

function describeEdit(edit: Edit): string {
  const what =
    edit.label ?? (edit.object_ids.length > 0 ? texts.change.objectIds(edit.object_ids) : texts.change.object);
  if (edit.action === "name") return texts.change.named(what, edit.name ?? "");
  if (edit.action === "look_again") return texts.change.lookedAgain(edit.texts);
  if (edit.action === "align") return texts.change.alignedTo(edit.alignment?.frame ?? "");
  if (edit.action === "observe") return texts.change.observed;
  if (edit.action === "scale")
    return texts.change.scaledBy([...edit.known_lengths, ...edit.known_sizes].map((known) => known.meters));
  if (edit.action === "add") return texts.change.added(edit.name ?? "");
  const verb = (texts.change.verbs as Record<string, string | undefined>)[edit.action] ?? edit.action;
  return `${verb} ${what}`;
}

/** The newest first; the versions that the current one was made of, and itself, are its line. */
export function lineOf(versions: readonly SceneVersion[], current: string): ReadonlySet<string> {
  const parents = new Map(versions.map((each) => [each.version, each.parent]));
  const line = new Set<string>();
  for (let each = current; each && !line.has(each); each = parents.get(each) ?? "") line.add(each);
  return line;
}
