import { send } from "./http";
import type { Scene } from "./types";

/** Renames a scene, unless somebody else has renamed it since `expected` was its name. */
export async function renameScene(sceneId: string, name: string, expected: string): Promise<Scene> {
  const response = await send(`v1/scenes/${encodeURIComponent(sceneId)}`, {
    method: "PATCH",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify({ name, expected_name: expected }),
  });
  return (await response.json()) as Scene;
}
