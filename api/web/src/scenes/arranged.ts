import type { SceneSummary } from "../api/types";

export const ORDERS = ["newest", "name", "largest"] as const;
export type Order = (typeof ORDERS)[number];

const COMPARE: Record<Order, (one: SceneSummary, other: SceneSummary) => number> = {
  newest: (one, other) => Date.parse(other.created_at) - Date.parse(one.created_at),
  name: (one, other) => one.name.localeCompare(other.name, "en", { numeric: true, sensitivity: "base" }),
  largest: (one, other) => other.gaussians - one.gaussians,
};

/** The scenes in whose name each word of a text is, in an order. */
export function arranged(scenes: readonly SceneSummary[], text: string, order: Order): SceneSummary[] {
  const words = text.toLowerCase().split(/\s+/).filter(Boolean);
  return scenes.filter(({ name }) => words.every((word) => name.toLowerCase().includes(word))).sort(COMPARE[order]);
}
