import type { LookState } from "../state/lookState";
import { texts } from "../texts";
import { Check } from "../ui/fields";

/** Whether the scene's cameras are drawn, and the way to each photo. */
export function PhotoLook({ look }: { look: LookState }) {
  const cameras = look.all.value;
  if (cameras.length === 0) return null;
  return (
    <section class="photo-look" aria-label={texts.look.compare}>
      <label>
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
      <Check
        label={texts.look.cameras}
        checked={look.cameras.value}
        onChange={(checked) => look.showCameras(checked)}
      />
      <p class="hint">{texts.look.keys}</p>
    </section>
  );
}
