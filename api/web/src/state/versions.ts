import type { SceneVersion } from "../api/types";

const NAMING = new Set(["name", "unname", "merge", "discard"]);

/** The oldest version with the same Gaussians as `version`: edits that only name objects leave the splat as it is. */
export function geometryVersion(versions: readonly SceneVersion[], version: string): string {
  const byName = new Map(versions.map((each) => [each.version, each]));
  let current = version;
  for (;;) {
    const each = byName.get(current);
    if (!each?.parent || !each.edits.every((edit) => NAMING.has(edit.action))) return current;
    current = each.parent;
  }
}
