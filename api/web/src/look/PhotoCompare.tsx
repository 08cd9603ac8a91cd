import { useEffect, useState } from "preact/hooks";

import { isAbort } from "../api/http";
import { photoAddress } from "../api/photoCalls";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { ErrorNote } from "../ui/parts";
import { photoRect } from "../viewer/projection";

/** The photo of the camera where the view stands, over the scene's own picture of it; a slider says how much of which. */
export function PhotoCompare({ state }: { state: SceneState }) {
  const { look } = state;
  const [camera, view] = [look.camera.value, look.view.value];
  const stored = camera !== null && (look.photos.value?.has(camera.name) ?? false);
  const [address, error] = usePhoto(state, stored ? camera.name : "");
  if (!camera) return null;
  const number = look.all.value.indexOf(camera) + 1;
  const share = look.share.value;
  const standing = look.standing.value && view !== null;
  const rect = standing ? photoRect(camera, view, look.size.value) : null;
  return (
    <>
      {rect && address && (
        <>
          <img
            class="compared-photo"
            src={address}
            alt={texts.look.photoOf(camera.name)}
            data-photo={camera.name}
            style={{
              left: `${rect.left}px`,
              top: `${rect.top}px`,
              width: `${rect.width}px`,
              height: `${rect.height}px`,
              clipPath: `inset(0 ${(1 - share) * 100}% 0 0)`,
            }}
          />
          {share > 0 && share < 1 && (
            <div
              class="divider"
              aria-hidden="true"
              style={{
                left: `${rect.left + rect.width * share}px`,
                top: `${rect.top}px`,
                height: `${rect.height}px`,
              }}
            />
          )}
        </>
      )}
      <div class="compare-bar" role="group" aria-label={texts.look.compare}>
        <p class="compare-name">
          <strong>{camera.name}</strong> <span class="hint">{texts.look.numberOf(number, look.all.value.length)}</span>
        </p>
        <Button onClick={() => look.step(-1)} text={texts.look.previous} />
        <Button onClick={() => look.step(1)} text={texts.look.next} />
        {stored && (
          <label class="compare-slider">
            <span>{texts.look.scene}</span>
            <input
              type="range"
              min={0}
              max={100}
              value={Math.round(share * 100)}
              aria-label={texts.look.share}
              aria-valuetext={texts.look.shareText(share)}
              onInput={(event) => (look.share.value = Number(event.currentTarget.value) / 100)}
            />
            <span>{texts.look.photo}</span>
          </label>
        )}
        <Button onClick={() => look.leave()} text={texts.close} />
        {look.photos.value !== null && !stored && <p class="hint">{texts.look.notStored}</p>}
        {error !== null && <ErrorNote error={error} />}
      </div>
    </>
  );
}

/** The address of a camera's photo once it is loaded, and why it is not; no name, no photo. */
function usePhoto(state: SceneState, name: string): [string, unknown] {
  const [loaded, setLoaded] = useState({ name: "", address: "", error: null as unknown });
  useEffect(() => {
    if (!name) return;
    let gone = false;
    photoAddress(state.sceneId, state.version.peek(), name, true).then(
      (address) => !gone && setLoaded({ name, address, error: null }),
      (error: unknown) => !gone && !isAbort(error) && setLoaded({ name, address: "", error }),
    );
    return () => {
      gone = true;
    };
  }, [state, name]);
  return loaded.name === name && name ? [loaded.address, loaded.error] : ["", null];
}
