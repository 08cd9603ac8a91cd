import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { Form } from "../ui/fields";
import { isRest, poseOf, withAxis } from "../viewer/motions";
import { AXIS_NAMES } from "./Gizmo";

const DEGREE = Math.PI / 180;

/** Numbers of the motion on show, and what sends it: as a move, or as a copy there. */
export function MovePanel({ state }: { state: SceneState }) {
  const { change } = state;
  const motion = change.motion.value;
  if (!motion) return null;
  const ids = state.selected.value;
  const unit = state.selectedObjects.value[0]?.meters ? texts.change.meters : texts.change.units;
  const send = (action: "move" | "duplicate", message: string) =>
    void state.edit({ action, object_ids: [...ids], transform: poseOf(motion) }, message).then((done) => {
      if (done) change.motion.value = null;
    });
  const end = () => (change.motion.value = null);
  const axes = (legend: string, part: "shift" | "angles", scale: number) => (
    <fieldset>
      <legend>{legend}</legend>
      {AXIS_NAMES.map((name, axis) => (
        <label key={name}>
          {name}
          <input
            type="number"
            step="any"
            value={rounded((motion[part][axis] ?? 0) / scale)}
            onInput={(event) => {
              const value = event.currentTarget.valueAsNumber * scale;
              if (Number.isFinite(value))
                change.motion.value = { ...motion, [part]: withAxis(motion[part], axis, value) };
            }}
          />
        </label>
      ))}
    </fieldset>
  );
  return (
    <Form
      class="move object-card"
      aria-label={texts.change.moveOrTurn}
      onSubmit={() => send("move", texts.change.moved)}
      onKeyDown={(event) => event.key === "Escape" && end()}
    >
      <h2>{texts.change.moveOrTurn}</h2>
      {axes(texts.change.shift(unit), "shift", 1)}
      {axes(texts.change.turn, "angles", DEGREE)}
      <div class="buttons">
        <Button type="submit" class="primary" disabled={state.busy.value || isRest(motion)} text={texts.change.move} />
        <Button
          disabled={state.busy.value || isRest(motion)}
          onClick={() => send("duplicate", texts.change.copied)}
          text={texts.change.copy}
        />
        <Button onClick={end} text={texts.cancel} />
      </div>
    </Form>
  );
}

function rounded(value: number): number {
  return Number(value.toFixed(4));
}
