import type { Answer, PosedCamera, SceneObject } from "../api/types";

/** What the server writes into the file: see service/application/exporting/scene_page.py. */
export interface SceneData {
  name: string;
  cameras: PosedCamera[];
  gaussians: number;
  labels: string[];
  names: OfflineName[];
  answers: OfflineAnswer[];
  left_out: number;
  splat: string;
}

/** A name that the scene itself knows: as it is written, and the key under which its plural is the same. */
export interface OfflineName {
  name: string;
  key: string;
  answer: number;
}

/** What the server said when it was asked for that name. */
export interface OfflineAnswer {
  outcome: Answer["outcome"];
  sentence: string;
  objects: SceneObject[];
  /** Which Gaussians: packed bits, gzip, base64; empty for none. */
  rows: string;
}

const QUESTION = /^(?:please|where(?:'s| is| are)|what(?:'s| is| are)|find(?: me)?|show(?: me)?|locate|look for)\s+/;
const ARTICLE = /^(?:a|an|the|my|your|our|this|that|these|those|some|any)\s+/;
const EDGES = /^[\s?!.,;:"'“”‘’«»()[\]]+|[\s?!.,;:"'“”‘’«»()[\]]+$/gu;

/** A text without its case, edges, question words and article. */
export function plain(text: string): string {
  const folded = text.normalize("NFKC").toLowerCase().replace(/[-_]/g, " ").replace(/\s+/g, " ").replace(EDGES, "");
  return folded.replace(QUESTION, "").replace(ARTICLE, "").replace(EDGES, "");
}

/** The name that a text asks for, or null where the file cannot tell. */
export function nameOf(text: string, names: readonly OfflineName[]): OfflineName | null {
  const asked = plain(text);
  if (!asked) return null;
  const singular = [asked, asked.replace(/s$/, ""), asked.replace(/es$/, ""), asked.replace(/ies$/, "y")];
  return names.find((each) => plain(each.name) === asked) ?? names.find((each) => singular.includes(each.key)) ?? null;
}

/** What the address says behind `#?`: `q` a text, `view` from where to look. */
export function parameter(name: "q" | "view"): string {
  return new URLSearchParams(location.hash.replace(/^#\??/, "")).get(name) ?? "";
}

/** The bytes in a gzip stream. */
export async function unzipped(packed: Uint8Array<ArrayBuffer>): Promise<Uint8Array> {
  return new Uint8Array(
    await new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer(),
  );
}
