import { getJson, listAll, send } from "./http";
import type { components } from "./schema";

export type BestView = components["schemas"]["BestView"];
type BestViewList = components["schemas"]["BestViewList"];
type PhotoList = components["schemas"]["PhotoList"];
type Observation = components["schemas"]["Observation"];
type ObservationList = components["schemas"]["ObservationList"];

const PAGE_SIZE = "500";
const KEPT_PHOTOS = 60;

const path = (sceneId: string) => `v1/scenes/${encodeURIComponent(sceneId)}`;

/** Names of the cameras whose photos are stored with a scene. */
export async function listPhotos(sceneId: string, version: string, signal: AbortSignal): Promise<Set<string>> {
  const photos = (page: PhotoList) => page.photos;
  const query = { version, page_size: PAGE_SIZE };
  return new Set((await listAll(`${path(sceneId)}/photos`, photos, signal, query)).map(({ view }) => view));
}

/** The cameras that show some objects, or the answer to a text, best. */
export async function bestViews(
  sceneId: string,
  version: string,
  of: { objects: readonly number[] } | { text: string },
  signal: AbortSignal,
): Promise<BestView[]> {
  const query = new URLSearchParams({ version });
  if ("text" in of) query.set("text", of.text);
  else for (const id of of.objects) query.append("object_ids", String(id));
  return (await getJson<BestViewList>(`${path(sceneId)}/views?${query}`, signal)).views;
}

/** Photos of another day, compared with the scene and kept with it. */
export async function observe(sceneId: string, files: readonly File[]): Promise<Observation> {
  const body = new FormData();
  for (const file of files) body.append("photos", file);
  return (await (await send(`${path(sceneId)}/observations`, { method: "POST", body })).json()) as Observation;
}

/** What photos of other days said of a scene, the newest first. */
export function listObservations(sceneId: string, version: string, signal: AbortSignal): Promise<Observation[]> {
  const observations = (page: ObservationList) => page.observations;
  return listAll(`${path(sceneId)}/observations`, observations, signal, { version, page_size: PAGE_SIZE });
}

const photos = new Map<string, Promise<string>>(); // object URLs: a photo of a scene never changes

/** An address of a photo, or of the scene's picture from a camera without one, that an `<img>` may show. */
export function photoAddress(sceneId: string, version: string, view: string, stored: boolean): Promise<string> {
  const key = JSON.stringify([sceneId, view, stored ? "" : version]);
  const known = photos.get(key);
  if (known) return known;
  const query = new URLSearchParams({ view, version });
  const loading = send(`${path(sceneId)}/${stored ? "photo.jpg" : "rgb.png"}?${query}`)
    .then((response) => response.blob())
    .then((blob) => URL.createObjectURL(blob));
  photos.set(key, loading);
  loading.catch(() => photos.delete(key)); // the next one who asks tries again
  for (const [oldest, address] of photos) {
    if (photos.size <= KEPT_PHOTOS) break;
    photos.delete(oldest);
    address.then(
      (url) => URL.revokeObjectURL(url),
      () => undefined,
    );
  }
  return loading;
}
