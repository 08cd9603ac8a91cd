import type { PickedObject, PickLevel } from "../api/types";

/** The level after the one that was picked: part, object, group, part, as far as they are there. */
export function nextLevel({ levels, level }: Pick<PickedObject, "levels" | "level">): PickLevel {
  const there = levels.map((each) => each.level);
  return there[(there.indexOf(level) + 1) % there.length] ?? "object";
}
