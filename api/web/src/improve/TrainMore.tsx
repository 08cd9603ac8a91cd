import type { Operation } from "../api/types";
import { texts } from "../texts";
import { SceneOrder } from "./SceneOrder";

const PRESETS = ["draft", "balanced", "best"] as const;

/** Trains the scene further, from where it is; the job is followed to its end. */
export function TrainMore({ sceneId, onDone }: { sceneId: string; onDone: () => void }) {
  return (
    <SceneOrder
      sceneId={sceneId}
      call="trainMore"
      words={texts.trainMore}
      body={(form) => ({ preset: form.get("preset") })}
      result={outcome}
      onDone={onDone}
    >
      <label>
        {texts.trainMore.preset}
        <select name="preset">
          {PRESETS.map((name) => (
            <option key={name} value={name} selected={name === "balanced"}>
              {texts.trainMore.presets[name]}
            </option>
          ))}
        </select>
      </label>
    </SceneOrder>
  );
}

function outcome({ train_more: result }: Operation) {
  if (!result) return null;
  return (
    <>
      {result.psnr !== null && result.psnr_before !== null && (
        <p>{texts.trainMore.better(result.psnr_before, result.psnr)}</p>
      )}
      {!result.current && <p>{texts.trainMore.beside}</p>}
    </>
  );
}
