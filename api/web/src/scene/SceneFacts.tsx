import type { Scene } from "../api/types";
import { LeftOutFiles } from "../jobs/LeftOutFiles";
import { texts } from "../texts";

/** How large and how good the scene is. */
export function SceneFacts({ scene }: { scene: Scene }) {
  const { registered, images, psnr } = scene.quality as Record<string, unknown>;
  const facts = [
    texts.scenes.gaussians(scene.gaussians),
    registered !== undefined && images !== undefined && texts.scene.registered(registered, images),
    typeof psnr === "number" && texts.scene.psnr(psnr),
  ];
  return (
    <section class="facts">
      <p class="hint">{facts.filter(Boolean).join(" · ")}</p>
      <LeftOutFiles files={scene.quality["left_out"]} />
      <Withheld quality={scene.quality} />
    </section>
  );
}

/** What a scene's photos withhold, in a sentence; nothing where nobody looked for any. */
function Withheld({ quality }: { quality: Readonly<Record<string, unknown>> }) {
  const report = quality.withheld as { privacy: string | null; photos: number; share: number } | null | undefined;
  if (!report) return null;
  return <p class="hint">{texts.privacy.withheld(report.privacy === "people", report.photos, report.share)}</p>;
}
