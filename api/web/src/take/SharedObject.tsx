import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { boxSize, centerOf } from "../viewer/boxes";
import type { Vec } from "../viewer/vectors";

/** What is selected, for who may only look. */
export function SharedObject({ state, onFly }: { state: SceneState; onFly: (middle: Vec, size: number) => void }) {
  const objects = state.selectedObjects.value;
  if (objects.length === 0) return null;
  return (
    <section class="object" aria-label={texts.objects.selected(objects.length)}>
      {objects.map((object) => {
        const { box } = object;
        const facts = [
          object.name && texts.objects.probability(object.probability),
          texts.scenes.gaussians(object.gaussian_count),
          box && texts.objects.sizeOf([box.size.x, box.size.y, box.size.z], object.meters),
        ];
        return (
          <div class="object-card" key={object.id}>
            <h2>{texts.objects.titleOf(object)}</h2>
            <p class="hint">{facts.filter(Boolean).join(" · ")}</p>
            {box && <Button onClick={() => onFly(centerOf(box), boxSize(box))} text={texts.objects.lookAt} />}
          </div>
        );
      })}
      <Button onClick={() => state.clearSelection()} text={texts.objects.close} />
    </section>
  );
}
