import { getJson, listAll, post, postJson, send } from "./http";
import type { paths } from "./schema";
import type {
  Answer,
  Edit,
  Measurement,
  Operation,
  PickedObject,
  PickIn,
  Place,
  Pose,
  PosedCamera,
  QueryOut,
  RenderIn,
  Scene,
  SceneList,
  SceneSummary,
  SceneObject,
  SceneVersion,
  ObjectList,
  VersionList,
} from "./types";

/** Every scene of the caller's project, newest first. */
export function listScenes(): Promise<SceneSummary[]> {
  return listAll("v1/scenes", (page: SceneList) => page.scenes);
}

export function getScene(sceneId: string, signal?: AbortSignal): Promise<Scene> {
  return getJson<Scene>(`v1/scenes/${encodeURIComponent(sceneId)}`, signal);
}

/** The project's copy of the sample scene, made where there is none. */
export function openSample(): Promise<Scene> {
  return postJson<Scene>("v1/scenes:openSample", {});
}

export async function deleteScene(sceneId: string): Promise<void> {
  await send(`v1/scenes/${encodeURIComponent(sceneId)}`, { method: "DELETE" });
}

export function getOperation(operationId: string, signal?: AbortSignal): Promise<Operation> {
  return getJson<Operation>(`v1/operations/${encodeURIComponent(operationId)}`, signal);
}

export async function cancelOperation(operationId: string): Promise<void> {
  await send(`v1/operations/${encodeURIComponent(operationId)}:cancel`, { method: "POST" });
}

export async function retryOperation(operationId: string, exclude: readonly string[] = []): Promise<void> {
  await post(`v1/operations/${encodeURIComponent(operationId)}:retry`, { exclude });
}

export async function listVersions(sceneId: string): Promise<SceneVersion[]> {
  return (await getJson<VersionList>(`v1/scenes/${encodeURIComponent(sceneId)}/versions`)).versions;
}

/** Every object of a version, by id, each followed by its parts. */
export function listObjects(sceneId: string, version: string): Promise<SceneObject[]> {
  const path = `v1/scenes/${encodeURIComponent(sceneId)}/objects`;
  return listAll(path, (page: ObjectList) => page.objects, undefined, { version, parts: "true" });
}

/** The answer to a text: ranked labels, objects, and their Gaussians (packed bits). "Left of" is as `asker` sees it. */
export async function ask(
  sceneId: string,
  version: string,
  text: string,
  asker: Pose | null,
  signal?: AbortSignal,
): Promise<Answer> {
  const body = { texts: [text], version, outputs: ["objects", "mask3d"], mask3d_encoding: "bits", asker };
  const { answers } = await postJson<QueryOut>(`v1/scenes/${encodeURIComponent(sceneId)}:query`, body, signal);
  const [answer] = answers;
  if (!answer) throw new Error("an answer to no text");
  return answer;
}

/** The Gaussians that answer a text, as a PLY file. */
export async function maskPly(sceneId: string, version: string, text: string): Promise<Uint8Array<ArrayBuffer>> {
  const body = { texts: [text], version, outputs: ["mask3d"], mask3d_encoding: "ply" };
  const { answers } = await postJson<QueryOut>(`v1/scenes/${encodeURIComponent(sceneId)}:query`, body);
  return Uint8Array.from(atob(answers[0]?.mask3d ?? ""), (letter) => letter.charCodeAt(0));
}

/** The answer of each ready scene to one text, with the objects that answer. */
export async function askEveryScene(text: string, signal?: AbortSignal): Promise<readonly Answer[]> {
  const query = new URLSearchParams({ text, outputs: "objects" });
  return (await getJson<QueryOut>(`query?${query}`, signal)).answers;
}

/** What a free viewpoint shows at a pixel of it, with its masks there: in the picture, and of Gaussians if asked for. */
export function pick(
  sceneId: string,
  version: string,
  camera: PosedCamera,
  pixel: { x: number; y: number },
  signal?: AbortSignal,
  more: Partial<Pick<PickIn, "level" | "mask3d">> = {},
): Promise<PickedObject> {
  const body = { camera, pixel, version, ...more };
  return postJson<PickedObject>(`v1/scenes/${encodeURIComponent(sceneId)}:pick`, body, signal);
}

/** Which object each Gaussian belongs to: uint16 by row, 0 for none. */
export async function objectsOfGaussians(sceneId: string, version: string, signal?: AbortSignal): Promise<Uint16Array> {
  const path = exportPath(sceneId, "objects", version);
  return new Uint16Array(await (await send(path, signal ? { signal } : {})).arrayBuffer());
}

export function edit(sceneId: string, version: string, edits: Partial<Edit>[]): Promise<SceneVersion> {
  const body = { edits, version, request_id: newRequestId() };
  return postJson<SceneVersion>(`v1/scenes/${encodeURIComponent(sceneId)}:edit`, body);
}

/** Where a place is, how large an object is, or how far two places are from each other. */
export function measure(sceneId: string, version: string, places: readonly Place[]): Promise<Measurement> {
  return postJson<Measurement>(`v1/scenes/${encodeURIComponent(sceneId)}:measure`, { places, version });
}

export function undo(sceneId: string, version: string): Promise<SceneVersion> {
  return postJson<SceneVersion>(`v1/scenes/${encodeURIComponent(sceneId)}:undo`, { version });
}

export function redo(sceneId: string, version: string): Promise<SceneVersion> {
  return postJson<SceneVersion>(`v1/scenes/${encodeURIComponent(sceneId)}:redo`, { version });
}

/** Makes any version current, if `expected` still is. */
export function restore(sceneId: string, version: string, expected: string): Promise<SceneVersion> {
  return postJson<SceneVersion>(`v1/scenes/${encodeURIComponent(sceneId)}:restore`, { version, expected });
}

/** A picture of the scene from a free viewpoint, as JPEG. */
export async function renderPicture(
  sceneId: string,
  camera: PosedCamera,
  signal?: AbortSignal,
  more: Partial<RenderIn> = {},
): Promise<Blob> {
  const body: Partial<RenderIn> = { kind: "rgb", camera, format: "jpeg", ...more };
  return (await post(`v1/scenes/${encodeURIComponent(sceneId)}:render`, body, signal)).blob();
}

/** The formats in which a scene can be taken away. */
export type ExportFormat = paths["/v1/scenes/{scene_id}/scene.{format}"]["get"]["parameters"]["path"]["format"];

/** The address of a scene, or of some of its objects, as a file. */
export function exportPath(sceneId: string, format: ExportFormat, version: string, objects: readonly number[] = []) {
  const query = new URLSearchParams({ version });
  for (const id of objects) query.append("object_ids", String(id));
  return `v1/scenes/${encodeURIComponent(sceneId)}/scene.${format}?${query}`;
}

/** How many bytes a file of the server has; null where it does not say so. */
export async function fileSize(path: string, signal: AbortSignal): Promise<number | null> {
  return Number((await send(path, { method: "HEAD", signal })).headers.get("Content-Length")) || null;
}

/** Where the page finds Gaussians to draw, or few of them, enough to say where surfaces are. */
export function splatPath(sceneId: string, version: string, coarse: boolean) {
  return `${exportPath(sceneId, "spz", version)}${coarse ? "&coarse=true" : ""}`;
}

/** An id for a request that may be sent twice. (crypto.randomUUID exists on https and localhost only.) */
export function newRequestId(): string {
  return [...crypto.getRandomValues(new Uint8Array(16))].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}
