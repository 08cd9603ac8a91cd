import { useEffect, useMemo, useState } from "preact/hooks";

import { isAbort } from "../api/http";
import type { BestView } from "../api/photoCalls";
import { bestViews, photoAddress } from "../api/photoCalls";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { decodeRle, outlinePixels } from "./outline";

const FOUND = [255, 176, 32] as const;

interface Properties {
  state: SceneState;
  /** Whose: those of an answer, by its text, or an object. */
  text?: string;
  object?: number;
}

/** The photos that show something best, with its outline; a click flies to where the photo was taken. */
export function BestPhotos({ state, text = "", object = 0 }: Properties) {
  const [views, setViews] = useState<readonly BestView[]>([]);
  // What is in one version may be gone in the next: that of the answer, or of the objects that are listed.
  const version = text ? (state.answer.value?.version ?? "") : state.objectsVersion.value;
  useEffect(() => {
    if (!version) return;
    const controller = new AbortController();
    const { signal } = controller;
    setViews([]);
    bestViews(state.sceneId, version, text ? { text } : { objects: [object] }, signal).then(
      (loaded) => !signal.aborted && setViews(loaded),
      (error: unknown) => {
        if (!signal.aborted && !isAbort(error)) state.actionError.value = error;
      },
    );
    return () => controller.abort();
  }, [state, version, text, object]);
  if (views.length === 0) return null;
  const title = views.some((view) => view.photo) ? texts.look.bestPhotos : texts.look.bestViews;
  return (
    <div class="best-photos">
      <h3>{title}</h3>
      <ul>
        {views.map((view) => (
          <li key={view.view}>
            <button
              type="button"
              title={texts.look.best(view.view, view.share)}
              aria-label={texts.look.flyTo(view.view)}
              onClick={() => state.look.goTo(view.view)}
            >
              <Picture state={state} version={version} view={view} />
              <Outline view={view} />
            </button>
          </li>
        ))}
      </ul>
    </div>
  );
}

function Picture({ state, version, view }: { state: SceneState; version: string; view: BestView }) {
  const [address, setAddress] = useState("");
  useEffect(() => {
    let gone = false;
    photoAddress(state.sceneId, version, view.view, view.photo).then(
      (loaded) => !gone && setAddress(loaded),
      () => undefined, // its outline shows where the object is without it
    );
    return () => {
      gone = true;
    };
  }, [state, version, view]);
  return address ? <img class="picture" src={address} alt="" /> : null;
}

function Outline({ view }: { view: BestView }) {
  const { segmentation } = view.mask;
  const address = useMemo(() => {
    if (!segmentation) return "";
    const mask = decodeRle(segmentation);
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [mask.width, mask.height];
    canvas.getContext("2d")?.putImageData(new ImageData(outlinePixels(mask, FOUND), mask.width), 0, 0);
    return canvas.toDataURL();
  }, [segmentation]);
  return address ? <img class="outline" src={address} alt="" /> : null;
}
