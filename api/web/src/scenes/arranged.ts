import type { DictionaryEntry, SceneSummary } from "../api/types";

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

/** The names of a dictionary that something in the scene bears, those of most Gaussians first. */
export function namesIn(dictionary: readonly Pick<DictionaryEntry, "label" | "gaussian_count">[]): string[] {
  const borne = dictionary.filter(({ gaussian_count: count }) => count > 0);
  return borne.sort((one, other) => other.gaussian_count - one.gaussian_count).map(({ label }) => label);
}
