import { useEffect, useState } from "preact/hooks";

import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { Form } from "../ui/fields";
import { centerOf } from "../viewer/boxes";
import { beginPrompt } from "./prompts";
import { beginRuler } from "./ruler";

/** What can be done to the selected objects: hidden and isolated on show; recolored, moved, copied, removed as versions. */
export function ObjectTools({ state }: { state: SceneState }) {
  const { change } = state;
  useEffect(
    () => state.selected.subscribe(() => (change.motion.value = null)), // it was of those that were selected before
    [state, change],
  );
  const objects = state.selectedObjects.value;
  const [first] = objects;
  if (!first) return null;
  const ids = objects.map((object) => object.id);
  const box = objects.find((object) => object.box)?.box;
  return (
    <section class="object-tools" aria-labelledby="tools-title">
      <h2 id="tools-title">{texts.change.title}</h2>
      <div class="buttons">
        <Button onClick={() => change.hide(ids)} text={texts.change.hide} />
        <Button onClick={() => change.isolate(ids)} text={texts.change.isolate} />
        {box && (
          <Button
            onClick={() => (change.motion.value = { pivot: centerOf(box), shift: [0, 0, 0], angles: [0, 0, 0] })}
            text={texts.change.moveOrTurn}
          />
        )}
        {objects.length === 1 && (
          <Button
            disabled={state.busy.value}
            onClick={() => beginPrompt(state, "split", first.id)}
            text={texts.change.split}
          />
        )}
        {box && !first.meters && <Button onClick={() => beginRuler(state)} text={texts.change.measureForMeters} />}
        <Button
          class="danger"
          disabled={state.busy.value}
          onClick={() => void state.edit({ action: "remove", object_ids: ids }, texts.change.removed)}
          text={texts.change.remove}
        />
      </div>
      <Recolor state={state} ids={ids} />
    </section>
  );
}

/** What is done to no object in particular. */
export function SceneTools({ state }: { state: SceneState }) {
  return (
    <div class="buttons">
      <Button disabled={state.busy.value} onClick={() => beginPrompt(state, "add")} text={texts.change.add} />
      {state.change.hides.value && <Button onClick={() => state.change.showAll()} text={texts.change.showAll} />}
    </div>
  );
}

function Recolor({ state, ids }: { state: SceneState; ids: number[] }) {
  const [color, setColor] = useState("#3d7be0");
  const [r = 0, g = 0, b = 0] = [1, 3, 5].map((at) => parseInt(color.slice(at, at + 2), 16) / 255);
  return (
    <Form
      class="recolor"
      onSubmit={() =>
        void state.edit({ action: "recolor", object_ids: ids, color: { r, g, b } }, texts.change.recolored)
      }
    >
      <label>
        {texts.change.color}
        <input type="color" value={color} onInput={(event) => setColor(event.currentTarget.value)} />
      </label>
      <Button type="submit" disabled={state.busy.value} text={texts.change.recolor} />
    </Form>
  );
}
