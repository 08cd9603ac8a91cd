import type { Role } from "./types";

/** The roles whose holders may do what those before them may; uploaders and suggesters are apart. */
const ORDERED_ROLES: readonly Role[] = ["reader", "editor", "admin", "operator"];

/** Whether a caller of this role may do what needs another. */
export function mayDo(role: Role, needed: Role): boolean {
  return ORDERED_ROLES.indexOf(role) >= ORDERED_ROLES.indexOf(needed);
}

/** The roles of the keys that a caller may make: none above its own. */
export function rolesUpTo(role: Role): readonly Role[] {
  return ["suggester", ...ORDERED_ROLES.slice(0, ORDERED_ROLES.indexOf(role) + 1)];
}
