import type { Vec } from "./vectors";

/** A color that covers a share of what it lies over: red, green, blue and strength, 0..1. */
export interface Tint {
  color: Vec;
  strength: number;
}

/** What was found, is pointed at, or is selected; whether the browser draws it or the server. */
export const TINTS = {
  found: { color: [1, 0.56, 0.06], strength: 0.75 },
  hovered: { color: [0.35, 0.85, 1], strength: 0.55 },
  selected: { color: [0.1, 0.55, 1], strength: 0.65 },
} satisfies Record<string, Tint>;

/** What is left of the brightness of the rest while something is found or selected. */
export const DIMMED = 0.45;
