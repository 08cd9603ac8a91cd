import { postJson } from "./http";
import type { NamerResult, NamerStatus } from "./types";

/** Lets pictures of the project's things go to the host of the server's namer; "" takes that back. */
export function agreeToNamer(host: string): Promise<NamerStatus> {
  return postJson<NamerStatus>("v1/namer:agree", { host });
}

/** What the server's namer says of a scene's things without a name; it takes minutes. */
export function askNamer(sceneId: string): Promise<NamerResult> {
  return postJson<NamerResult>(`v1/scenes/${encodeURIComponent(sceneId)}:askNamer`, {});
}
