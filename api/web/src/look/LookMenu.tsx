import { useMemo } from "preact/hooks";

import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import type { LegendEntry } from "../viewer/colors";
import { AXES, coloringByLabel, coloringByThing, css, DEPTH_STOPS, MODES, NOTHING } from "../viewer/colors";

const SHOWN_ENTRIES = 40;

/** The menu "View": what the colors say, whether the cameras are drawn, and the way to each photo. */
export function LookMenu({ state }: { state: SceneState }) {
  const { look } = state;
  const cameras = look.all.value;
  return (
    <details class="look-menu">
      <summary>{texts.look.menu}</summary>
      <fieldset>
        <legend>{texts.look.colors}</legend>
        {MODES.map((mode) => (
          <label key={mode} class="look-choice">
            <input
              type="radio"
              name="look-mode"
              checked={look.mode.value === mode}
              onChange={() => look.setMode(mode)}
            />
            {texts.look.modes[mode]}
          </label>
        ))}
      </fieldset>
      {cameras.length > 0 && (
        <>
          <label class="look-choice">
            <input
              type="checkbox"
              checked={look.cameras.value}
              onChange={(event) => look.showCameras(event.currentTarget.checked)}
            />
            {texts.look.cameras}
          </label>
          <label class="look-photo">
            {texts.look.standAt}
            <select
              value={look.at.value}
              onChange={(event) => (event.currentTarget.value ? look.goTo(event.currentTarget.value) : look.leave())}
            >
              <option value="">{texts.look.nowhere}</option>
              {cameras.map((camera) => (
                <option key={camera.name} value={camera.name}>
                  {camera.name}
                </option>
              ))}
            </select>
          </label>
          <p class="hint">{texts.look.keys}</p>
        </>
      )}
    </details>
  );
}

/** What the colors on show mean; nothing for the photos' own. */
export function Legend({ state }: { state: SceneState }) {
  const { look } = state;
  const [mode, things, depths] = [look.mode.value, state.things.value, look.depths.value];
  const entries = useMemo((): readonly LegendEntry[] => {
    if (mode === "things") return coloringByThing(things ?? [], texts.things.titleOf).legend;
    if (mode === "normals") return texts.look.axes.map((name, index) => ({ name, color: AXES[index] ?? NOTHING }));
    return mode === "labels" ? coloringByLabel(things ?? []).legend : [];
  }, [mode, things]);
  if (mode === "photo" || look.standing.value) return null;
  const unit = state.scene.value?.scale === "METRIC" ? texts.look.meters : texts.look.units;
  return (
    <section class="legend" aria-label={texts.look.legend}>
      <h2>{texts.look.modes[mode]}</h2>
      {mode === "depth" ? (
        depths && (
          <p class="depth-scale">
            <span>{texts.look.depth(depths[0], unit)}</span>
            <svg viewBox={`0 0 ${DEPTH_STOPS.length - 1} 1`} preserveAspectRatio="none" aria-hidden="true">
              <linearGradient id="depth-colors">
                {DEPTH_STOPS.map((color, index) => (
                  <stop key={index} offset={index / (DEPTH_STOPS.length - 1)} stop-color={css(color)} />
                ))}
              </linearGradient>
              <rect width={DEPTH_STOPS.length - 1} height="1" fill="url(#depth-colors)" />
            </svg>
            <span>{texts.look.depth(depths[1], unit)}</span>
          </p>
        )
      ) : (
        <ul>
          {entries.slice(0, SHOWN_ENTRIES).map((entry, index) => (
            <li key={index}>
              <svg class="swatch" viewBox="0 0 1 1" aria-hidden="true">
                <rect width="1" height="1" fill={css(entry.color)} />
              </svg>
              {entry.name}
            </li>
          ))}
          {entries.length > SHOWN_ENTRIES && <li>{texts.look.more(entries.length - SHOWN_ENTRIES)}</li>}
          {entries.length === 0 && <li>{texts.look.none}</li>}
        </ul>
      )}
    </section>
  );
}
