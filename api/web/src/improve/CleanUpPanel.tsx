import { signal } from "@preact/signals";
import { useEffect, useState } from "preact/hooks";

import type { EditPreview } from "../api/cleanUpCalls";
import { previewEdit } from "../api/cleanUpCalls";
import { isAbort } from "../api/http";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { Check } from "../ui/fields";
import { ErrorNote } from "../ui/parts";
import { Projection } from "../viewer/projection";
import { fromBase64, unpackBits } from "../viewer/states";
import type { Vec } from "../viewer/vectors";
import type { CleanUp, CropBox } from "./cleanUp";
import { boxAround, edgesOf, editsOf, NOTHING, reachOf } from "./cleanUp";
import "./improve.css";

const REST_MS = 200; // a slider that moves asks nothing
const LEAST_ISOLATION = 1.5;
const MOST_ISOLATION = 10;

/** The box on show while it is open. */
const shownBox = signal<CropBox | null>(null);

/** Takes faint and stray Gaussians, objects and what is beside a box out of the scene: shown at once, then a version. */
export function CleanUpPanel({ state }: { state: SceneState }) {
  const [open, setOpen] = useState(false);
  return (
    <details class="improve" open={open} onToggle={(event) => setOpen(event.currentTarget.open)}>
      <summary>{texts.cleanUp.title}</summary>
      {open && <Controls state={state} onDone={() => setOpen(false)} />}
    </details>
  );
}

function Controls({ state, onDone }: { state: SceneState; onDone: () => void }) {
  const [tool, setTool] = useState<CleanUp>(NOTHING);
  const [preview, setPreview] = useState<EditPreview | null>(null);
  const [error, setError] = useState<unknown>(null);
  const { change } = state;
  const set = (changes: Partial<CleanUp>) => setTool((before) => ({ ...before, ...changes }));
  const version = state.objectsVersion.value; // in a newer one, an object that is marked may be gone
  const listed = state.objects.value ?? [];
  const objects = (change.brush.value ?? []).filter((id) => listed.some((object) => object.id === id));
  const edits = editsOf({ ...tool, objects });
  const asked = JSON.stringify(edits);
  const cameras = state.scene.value?.cameras ?? [];

  useEffect(() => {
    shownBox.value = tool.box;
  }, [tool.box]);
  const left = state.tab.value !== "objects";
  useEffect(() => {
    if (left) onDone(); // the view is another tab's
  }, [left]); // eslint-disable-line react-hooks/exhaustive-deps -- what ends it does the same each time
  useEffect(
    () => () => {
      shownBox.value = change.going.value = change.brush.value = null;
    },
    [change],
  );
  useEffect(() => {
    setError(null);
    if (edits.length === 0) {
      setPreview(null);
      change.going.value = null;
      return;
    }
    const controller = new AbortController();
    const timer = window.setTimeout(() => {
      previewEdit(state.sceneId, version, edits, controller.signal).then(
        (told) => {
          setPreview(told);
          change.going.value = unpackBits(fromBase64(told.mask3d), told.gaussians);
        },
        (problem: unknown) => !isAbort(problem) && setError(problem),
      );
    }, REST_MS);
    return () => {
      window.clearTimeout(timer);
      controller.abort();
    };
  }, [state, change, version, asked]); // eslint-disable-line react-hooks/exhaustive-deps -- `asked` says what `edits` are

  const current = preview?.version === state.version.value && preview.counts.length === edits.length ? preview : null;
  const all = current !== null && current.count === current.gaussians;
  const apply = async () => {
    const useful = edits.filter((_, number) => (current?.counts[number] ?? 0) > 0);
    if (await state.editAll(useful, texts.cleanUp.done)) onDone();
  };
  return (
    <>
      <Slider
        label={texts.cleanUp.faint}
        value={tool.opacity}
        range={[0, 0.5, 0.01]}
        said={tool.opacity ? texts.cleanUp.below(tool.opacity) : texts.cleanUp.off}
        onChange={(opacity) => set({ opacity })}
      />
      <Slider
        label={texts.cleanUp.stray}
        value={tool.isolation ? MOST_ISOLATION - tool.isolation : 0}
        range={[0, MOST_ISOLATION - LEAST_ISOLATION, 0.5]}
        said={tool.isolation ? texts.cleanUp.farther(tool.isolation) : texts.cleanUp.off}
        onChange={(value) => set({ isolation: value ? MOST_ISOLATION - value : 0 })}
      />
      <Check
        label={texts.cleanUp.box}
        checked={tool.box !== null}
        onChange={(checked) => set({ box: checked ? boxAround(cameras) : null })}
      />
      {tool.box && (
        <BoxSliders
          box={tool.box}
          reach={reachOf(cameras)}
          outside={tool.outside}
          onChange={(box) => set({ box })}
          onSide={(outside) => set({ outside })}
        />
      )}
      <Check
        label={texts.cleanUp.brush}
        checked={change.brush.value !== null}
        onChange={(checked) => (change.brush.value = checked ? [] : null)}
      />
      {change.brush.value !== null && <p class="hint">{texts.cleanUp.brushHelp(objects.length)}</p>}
      {error !== null && <ErrorNote error={error} />}
      <p role="status">{current && (all ? texts.cleanUp.all : texts.cleanUp.goes(current.count, current.gaussians))}</p>
      <div class="buttons">
        <Button
          class="danger"
          disabled={state.busy.value || !current?.count || all}
          onClick={() => void apply()}
          text={texts.cleanUp.apply}
        />
        <Button onClick={onDone} text={texts.cancel} />
      </div>
    </>
  );
}

interface BoxProperties {
  box: CropBox;
  /** How far the box may reach from its middle. */
  reach: number;
  outside: boolean;
  onChange: (box: CropBox) => void;
  onSide: (outside: boolean) => void;
}

function BoxSliders({ box, reach, outside, onChange, onSide }: BoxProperties) {
  const step = reach / 100;
  return (
    <fieldset>
      <legend class="sr-only">{texts.cleanUp.box}</legend>
      <label>
        {texts.cleanUp.side}
        <select value={String(outside)} onChange={(event) => onSide(event.currentTarget.value === "true")}>
          <option value="true">{texts.cleanUp.keepInside}</option>
          <option value="false">{texts.cleanUp.keepOutside}</option>
        </select>
      </label>
      {texts.cleanUp.sides.map((label, number) => {
        const [axis, end] = [number >> 1, number & 1 ? "high" : "low"] as const;
        const set = (value: number) => {
          const other = box[end === "low" ? "high" : "low"][axis] ?? 0;
          const kept = end === "low" ? Math.min(value, other - step) : Math.max(value, other + step);
          const corner = box[end].map((before, at) => (at === axis ? kept : before)) as unknown as Vec;
          onChange({ ...box, [end]: corner });
        };
        return (
          <Slider key={label} label={label} value={box[end][axis] ?? 0} range={[-reach, reach, step]} onChange={set} />
        );
      })}
    </fieldset>
  );
}

interface SliderProperties {
  label: string;
  value: number;
  range: readonly [number, number, number];
  said?: string;
  onChange: (value: number) => void;
}

function Slider({ label, value, range: [min, max, step], said, onChange }: SliderProperties) {
  return (
    <label class="slider">
      <span>
        {label} {said && <span class="hint">{said}</span>}
      </span>
      <input
        type="range"
        min={min}
        max={max}
        step={step}
        value={value}
        aria-valuetext={said}
        onInput={(event) => onChange(Number(event.currentTarget.value))}
      />
    </label>
  );
}

/** The box over the 3D view, in its perspective; its sliders say the same. */
export function CropBoxLines({ state }: { state: SceneState }) {
  const { change } = state;
  const [box, view, size] = [shownBox.value, change.view.value, change.size.value];
  if (!box || !view || !size.width) return null;
  const projection = new Projection(view, size);
  const path = edgesOf(box)
    .map(([from, to]) => projection.line(from, to))
    .map((line) => (line ? `M${line[0].join(" ")}L${line[1].join(" ")}` : ""))
    .join("");
  return (
    <svg class="frusta hollow" viewBox={`0 0 ${size.width} ${size.height}`} aria-hidden="true">
      <path class="halo" d={path} />
      <path d={path} />
    </svg>
  );
}
