import { getJson, send } from "./http";
import type { PhotoVerdictList, PhotoVerdict, Scene } from "./types";

const PAGE_SIZE = 100;

/** What became of every photo of a scene, by name; `assessed` says whether anybody has looked. */
export async function listPhotos(sceneId: string): Promise<{ photos: PhotoVerdict[]; assessed: boolean }> {
  const photos: PhotoVerdict[] = [];
  for (let token = ""; ;) {
    const query = new URLSearchParams({ page_size: String(PAGE_SIZE), page_token: token });
    const page = await getJson<PhotoVerdictList>(`v1/scenes/${encodeURIComponent(sceneId)}/photo-verdicts?${query}`);
    photos.push(...page.photos);
    token = page.next_page_token;
    if (!token) return { photos, assessed: page.assessed };
  }
}

/** Renames a scene, unless somebody else has renamed it since `expected` was its name. */
export async function renameScene(sceneId: string, name: string, expected: string): Promise<Scene> {
  const response = await send(`v1/scenes/${encodeURIComponent(sceneId)}`, {
    method: "PATCH",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify({ name, expected_name: expected }),
  });
  return (await response.json()) as Scene;
}
