import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { boxSize, centerOf } from "../viewer/boxes";
import type { Vec } from "../viewer/vectors";

/** What is selected, for who may only look. */
export function SharedThing({ state, onFly }: { state: SceneState; onFly: (middle: Vec, size: number) => void }) {
  const things = state.selectedThings.value;
  if (things.length === 0) return null;
  return (
    <section class="thing" aria-label={texts.things.selected(things.length)}>
      {things.map((thing) => {
        const { box } = thing;
        const facts = [
          thing.name && texts.things.probability(thing.probability),
          texts.scenes.gaussians(thing.gaussian_count),
          box && texts.things.sizeOf([box.size.x, box.size.y, box.size.z], thing.meters),
        ];
        return (
          <div class="thing-card" key={thing.id}>
            <h2>{texts.things.titleOf(thing)}</h2>
            <p class="hint">{facts.filter(Boolean).join(" · ")}</p>
            {box && <Button onClick={() => onFly(centerOf(box), boxSize(box))} text={texts.things.lookAt} />}
          </div>
        );
      })}
      <Button onClick={() => state.clearSelection()} text={texts.things.close} />
    </section>
  );
}
