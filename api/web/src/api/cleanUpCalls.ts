import { postJson } from "./http";
import type { Edit, SceneObject } from "./types";

/** Which Gaussians a removal takes: those for which all that is said here is true. */
export interface GaussianFilter {
  box?: SceneObject["box"];
  outside: boolean;
  opacity_below?: number;
  isolation_above?: number;
}

export type CleanUpEdit = Pick<Edit, "action"> & { object_ids?: number[]; filter?: GaussianFilter };

/** What some removals would take. */
export interface EditPreview {
  version: string;
  gaussians: number;
  count: number;
  /** By each of the edits, of what those before it have left. */
  counts: readonly number[];
  /** A bit for each Gaussian of the version, base64. */
  mask3d: string;
}

export function previewEdit(
  sceneId: string,
  version: string,
  edits: readonly CleanUpEdit[],
  signal: AbortSignal,
): Promise<EditPreview> {
  return postJson<EditPreview>(`v1/scenes/${encodeURIComponent(sceneId)}:previewEdit`, { edits, version }, signal);
}
