import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { Button } from "../ui/Button";

/** Says where the crosshair is, for a keyboard that has moved the camera. */
export function MiddleButton({ state }: { state: SceneState }) {
  return (
    <Button
      disabled={state.busy.value}
      onClick={() => {
        const place = state.change.middle();
        if (place) state.change.onPlace.value?.(place);
      }}
      text={texts.change.middle}
    />
  );
}
