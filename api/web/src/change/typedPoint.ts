import type { Place } from "../api/types";

/** A point of the world as people type it: three numbers with spaces, commas or semicolons between; null for others. */
export function parsePoint(text: string): Place | null {
  const parts = text.trim().split(/[\s,;]+/);
  const [x, y, z] = parts.map(Number);
  if (parts.length !== 3 || x === undefined || y === undefined || z === undefined) return null;
  if (![x, y, z].every(Number.isFinite) || parts.some((part) => part === "")) return null;
  return { camera: null, view: null, pixel: null, point: { x, y, z }, object_id: null };
}
