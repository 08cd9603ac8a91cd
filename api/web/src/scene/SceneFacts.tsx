import { useState } from "preact/hooks";

import { exportPath } from "../api/calls";
import { send } from "../api/http";
import type { Scene } from "../api/types";
import { texts } from "../texts";
import { ErrorNote } from "../ui/parts";

const KEEP_MS = 60_000;

/** How large and how good the scene is, and its file. */
export function SceneFacts({ scene, version }: { scene: Scene; version: string }) {
  const [error, setError] = useState<unknown>(null);
  const { registered, images, psnr } = scene.quality as Record<string, unknown>;
  const facts = [
    texts.scenes.gaussians(scene.gaussians),
    registered !== undefined && images !== undefined && texts.scene.registered(registered, images),
    typeof psnr === "number" && texts.scene.psnr(psnr),
  ];
  const download = async () => {
    const blob = await (await send(exportPath(scene.id, "ply", version))).blob(); // a link of its own could not send the key
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = "scene.ply";
    link.click();
    window.setTimeout(() => URL.revokeObjectURL(link.href), KEEP_MS);
  };
  return (
    <section class="facts">
      <p class="hint">{facts.filter(Boolean).join(" · ")}</p>
      <button
        type="button"
        onClick={() => {
          setError(null);
          download().catch(setError);
        }}
      >
        {texts.scene.download}
      </button>
      {error !== null && <ErrorNote error={error} />}
    </section>
  );
}
