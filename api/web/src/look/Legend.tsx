import { useMemo } from "preact/hooks";

import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import type { LegendEntry } from "../viewer/colors";
import { AXES, coloringByLabel, coloringByObject, css, DEPTH_STOPS, NOTHING } from "../viewer/colors";
import { TINTS } from "../viewer/glow";

const SHOWN_ENTRIES = 40;

/** What the colors on show mean; nothing for the photos' own. */
export function Legend({ state }: { state: SceneState }) {
  const { look } = state;
  const [mode, objects, depths] = [look.mode.value, state.objects.value, look.depths.value];
  const entries = useMemo((): readonly LegendEntry[] => {
    if (mode === "objects") return coloringByObject(objects ?? [], texts.objects.titleOf).legend;
    if (mode === "normals") return texts.look.axes.map((name, index) => ({ name, color: AXES[index] ?? NOTHING }));
    return mode === "labels" ? coloringByLabel(objects ?? []).legend : [];
  }, [mode, objects]);
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

/** What lights up in the view, in words. */
export function GlowLegend({ state }: { state: SceneState }) {
  const lit = state.lit.value;
  if (!lit || state.look.standing.value) return null;
  const { color } = lit === "answer" ? TINTS.found : TINTS.selected;
  const [r, g, b] = color.map((part) => Math.round(255 * part));
  return (
    <p class="glow-legend">
      <svg class="swatch" viewBox="0 0 1 1" aria-hidden="true">
        <rect width="1" height="1" fill={`rgb(${r ?? 0} ${g ?? 0} ${b ?? 0})`} />
      </svg>
      <span>
        {lit === "answer"
          ? texts.look.glowsAnswer(state.answer.value?.text ?? "")
          : texts.look.glowsSelection(state.selectedObjects.value.map(texts.objects.titleOf))}
      </span>
    </p>
  );
}
