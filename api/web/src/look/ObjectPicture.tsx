import { useEffect, useRef } from "preact/hooks";

import { bestViews, photoAddress } from "../api/photoCalls";
import type { SceneState } from "../state/sceneState";
import { cropAround, decodeRle } from "./outline";

const SIDE = 96; // pixels

/** An object of the answer that has no name, as the photo shows it that shows it best. */
export function ObjectPicture({ state, object }: { state: SceneState; object: number }) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const version = state.answer.value?.version ?? "";
  useEffect(() => {
    if (!version) return;
    const controller = new AbortController();
    const { signal } = controller;
    const draw = async () => {
      const [best] = await bestViews(state.sceneId, version, { objects: [object] }, signal);
      if (!best?.mask.segmentation) return;
      const picture = new Image();
      picture.src = await photoAddress(state.sceneId, version, best.view, best.photo);
      await picture.decode();
      const mask = decodeRle(best.mask.segmentation);
      const [left, top, side] = cropAround(mask);
      const ratio = picture.naturalWidth / mask.width;
      const context = signal.aborted ? null : canvas.current?.getContext("2d");
      context?.drawImage(picture, left * ratio, top * ratio, side * ratio, side * ratio, 0, 0, SIDE, SIDE);
    };
    draw().catch(() => undefined); // its number stands beside it
    return () => controller.abort();
  }, [state, version, object]);
  return <canvas class="object-picture" ref={canvas} width={SIDE} height={SIDE} aria-hidden="true" />;
}
