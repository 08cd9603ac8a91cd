import { getJson, postJson } from "../api/http";
import type { components } from "../api/schema";

export type AccessKey = components["schemas"]["AccessKey"];

/** Makes a key that shows one scene alone; its secret is told this once. */
export function createShare(sceneId: string, name: string, days: number) {
  const body = { name, role: "reader", lifetime_s: days * 86_400, scene_id: sceneId };
  return postJson<components["schemas"]["NewKey"]>("v1/keys", body);
}

/** The keys that show this scene alone, newest first; of very many the first. */
export async function listShares(sceneId: string, signal?: AbortSignal): Promise<AccessKey[]> {
  const query = new URLSearchParams({ scene_id: sceneId, page_size: "100" });
  return (await getJson<components["schemas"]["KeyList"]>(`v1/keys?${query}`, signal)).keys;
}

export function revokeShare(keyId: string): Promise<AccessKey> {
  return postJson<AccessKey>(`v1/keys/${encodeURIComponent(keyId)}:revoke`, {});
}
