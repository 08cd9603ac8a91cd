import type { Scene } from "../api/types";
import { texts } from "../texts";
import { LeftOutFiles } from "../upload/LeftOutFiles";
import { Withheld } from "../upload/WithholdPeople";

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
