import { newRequestId } from "./calls";
import { postJson } from "./http";
import type { NamerStatus, Operation } from "./types";

/** Lets pictures of the project's objects go to the host of the server's namer; "" takes that back. */
export function agreeToNamer(host: string): Promise<NamerStatus> {
  return postJson<NamerStatus>("v1/namer:agree", { host });
}

/** Orders that the server's namer is asked about a scene's objects without a name. */
export function askNamer(sceneId: string): Promise<Operation> {
  return postJson<Operation>(`v1/scenes/${encodeURIComponent(sceneId)}:askNamer`, { request_id: newRequestId() });
}
