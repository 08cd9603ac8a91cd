import { newRequestId } from "./calls";
import { postJson } from "./http";
import type { CaptionerStatus, Operation } from "./types";

/** Lets pictures of the project's objects go to the host of the server's captioner; "" takes that back. */
export function agreeToCaptioner(host: string): Promise<CaptionerStatus> {
  return postJson<CaptionerStatus>("v1/captioner:agree", { host });
}

/** Orders that the server's captioner is asked about a scene's objects without a name. */
export function askCaptioner(sceneId: string): Promise<Operation> {
  return postJson<Operation>(`v1/scenes/${encodeURIComponent(sceneId)}:askCaptioner`, { request_id: newRequestId() });
}
