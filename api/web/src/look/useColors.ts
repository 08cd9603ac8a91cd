import type { Signal } from "@preact/signals";
import { useSignalEffect } from "@preact/signals";

import type { SceneState } from "../state/sceneState";
import { coloringByLabel, coloringByObject, tintsOf } from "../viewer/colors";
import type { SplatView } from "../viewer/splatView";
import { middleOf, normalTints } from "./normals";

/** Gives the Gaussians on show the colors that the look asks for. */
export function useColors(
  state: SceneState,
  splatView: Signal<SplatView | null>,
  loaded: Signal<number>,
  canvas: { current: HTMLCanvasElement | null },
): void {
  useSignalEffect(() => {
    const [view, count, mode] = [splatView.value, loaded.value, state.look.mode.value];
    if (!view || !count) return;
    const [owners, objects] = [state.owners.value, state.objects.value];
    if (mode === "depth") view.setDepthColors((range) => (state.look.depths.value = range));
    else if (mode === "photo") view.setOwnColors();
    else if (mode === "normals") view.setTints(normalTints(view.columns, middleOf(state.look.all.value)));
    else if (owners?.length === count && objects) {
      const { byObject } =
        mode === "objects" ? coloringByObject(objects, (object) => object.name) : coloringByLabel(objects);
      view.setTints(tintsOf(owners, byObject));
    } else return;
    if (canvas.current) canvas.current.dataset["colors"] = mode;
  });
}
