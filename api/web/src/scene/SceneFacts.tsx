import type { Scene } from "../api/types";
import { LeftOutFiles } from "../jobs/LeftOutFiles";
import { texts } from "../texts";

/** How large and how good the scene is, what more training would gain, and what its photos withhold. */
export function SceneFacts({ scene }: { scene: Scene }) {
  const { registered, images, psnr, next_doubling_db: gain } = scene.quality as Record<string, unknown>;
  const facts = [
    texts.scenes.gaussians(scene.gaussians),
    registered !== undefined && images !== undefined && texts.scene.registered(registered, images),
    typeof psnr === "number" && texts.scene.psnr(psnr),
    typeof gain === "number" && texts.scene.doubling(gain),
  ];
  const withheld = scene.quality.withheld as { privacy: string | null; photos: number; share: number } | null;
  return (
    <section class="facts">
      <p class="hint">{facts.filter(Boolean).join(" · ")}</p>
      <LeftOutFiles files={scene.quality["left_out"]} />
      {withheld && (
        <p class="hint">{texts.privacy.withheld(withheld.privacy === "people", withheld.photos, withheld.share)}</p>
      )}
    </section>
  );
}
