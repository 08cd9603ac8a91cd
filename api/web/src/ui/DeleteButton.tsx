import { useState } from "preact/hooks";

import { texts } from "../texts";
import { ErrorNote } from "../ui/parts";

/** Deletes the scene after a second question. */
export function DeleteScene({ name, onDelete }: { name: string; onDelete: () => Promise<void> }) {
  const [asked, setAsked] = useState(false);
  const [error, setError] = useState<unknown>(null);
  if (!asked)
    return (
      <button type="button" class="danger" onClick={() => setAsked(true)}>
        {texts.scene.remove}
      </button>
    );
  return (
    <div class="note" role="group" aria-label={texts.scene.remove}>
      <p>{texts.scene.removeQuestion(name)}</p>
      {error !== null && <ErrorNote error={error} />}
      <div class="buttons">
        <button
          type="button"
          class="danger"
          onClick={() => {
            setError(null);
            onDelete().catch(setError);
          }}
        >
          {texts.scene.removeYes}
        </button>
        <button type="button" onClick={() => setAsked(false)}>
          {texts.cancel}
        </button>
      </div>
    </div>
  );
}
