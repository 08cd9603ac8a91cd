import { useState } from "preact/hooks";

import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { Form } from "../ui/fields";
import { ErrorNote } from "../ui/parts";
import { Projection } from "../viewer/projection";
import { MiddleButton } from "./MiddleButton";
import { addPlace, endRuler } from "./ruler";
import { parsePoint } from "./typedPoint";

/** The places on show, and the line between them. */
export function RulerLine({ state }: { state: SceneState }) {
  const { change } = state;
  const [ruler, view, size] = [change.ruler.value, change.view.value, change.size.value];
  if (!ruler?.measured || !view || !size.width) return null;
  const { places, distance, meters } = ruler.measured;
  const projection = new Projection(view, size);
  const ends = places.map(({ point }) => projection.point([point.x, point.y, point.z]));
  const [from, to] = ends;
  return (
    <svg class="ruler" aria-hidden="true" viewBox={`0 0 ${size.width} ${size.height}`}>
      {from && to && <line x1={from[0]} y1={from[1]} x2={to[0]} y2={to[1]} />}
      {ends.map((end, number) => end && <circle key={number} cx={end[0]} cy={end[1]} r="6" />)}
      {from && to && distance && (
        <text x={(from[0] + to[0]) / 2} y={(from[1] + to[1]) / 2 - 12}>
          {texts.change.length(distance, meters)}
        </text>
      )}
    </svg>
  );
}

/** What the ruler says, and the form that makes the scene metric by a length that is known. */
export function RulerNote({ state }: { state: SceneState }) {
  const ruler = state.change.ruler.value;
  const [typed, setTyped] = useState("");
  if (!ruler) return null;
  const { measured } = ruler;
  const point = parsePoint(typed);
  return (
    <div class="note tool-note">
      <p role="status">
        {measured?.distance
          ? texts.change.apart(texts.change.length(measured.distance, measured.meters))
          : ruler.places.length === 1
            ? texts.change.rulerSecond
            : texts.change.rulerFirst}
      </p>
      {ruler.error !== null && <ErrorNote error={ruler.error} />}
      {measured?.distance && ruler.places.length === 2 && <KnownLengthForm state={state} />}
      <Form
        class="point"
        onSubmit={() => {
          if (point) void addPlace(state, point).then(() => setTyped(""));
        }}
      >
        <label>
          {texts.change.point}
          <input value={typed} autocomplete="off" onInput={(event) => setTyped(event.currentTarget.value)} />
        </label>
        <Button type="submit" disabled={!point} text={texts.change.takePoint} />
      </Form>
      <div class="buttons">
        <MiddleButton state={state} />
        <Button onClick={() => endRuler(state)} text={texts.change.rulerEnd} />
      </div>
    </div>
  );
}

function KnownLengthForm({ state }: { state: SceneState }) {
  const [meters, setMeters] = useState("");
  const value = Number(meters);
  const fits = meters.trim() !== "" && Number.isFinite(value) && value > 0;
  const send = async () => {
    const [first, second] = state.change.ruler.value?.places ?? [];
    if (!first || !second) return;
    const known_lengths = [{ first, second, meters: value, plus_minus: 0 }];
    if (await state.edit({ action: "scale", known_lengths }, texts.change.scaled)) endRuler(state);
  };
  return (
    <Form
      class="point"
      onSubmit={() => {
        if (fits) void send();
      }}
    >
      <label>
        {texts.change.reallyMeters}
        <input
          inputMode="decimal"
          value={meters}
          autocomplete="off"
          onInput={(event) => setMeters(event.currentTarget.value)}
        />
      </label>
      <Button type="submit" class="primary" disabled={!fits || state.busy.value} text={texts.change.setScale} />
    </Form>
  );
}

/** The size of the selected object with its interval, and what the scene's scale comes from. */
export function ScaleFacts({ state }: { state: SceneState }) {
  const scaling = state.scene.value?.scaling;
  if (!scaling) return null;
  const percent = (100 * (scaling.high - scaling.low)) / (2 * scaling.meters_per_unit);
  return <p class="hint">{texts.change.scaling(scaling.known_lengths, percent, scaling.source)}</p>;
}
