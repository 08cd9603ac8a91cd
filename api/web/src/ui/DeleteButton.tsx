import { useState } from "preact/hooks";

import { texts } from "../texts";
import { ErrorNote } from "./parts";

interface Properties {
  label: string;
  /** What is asked before anything is deleted. */
  question: string;
  onDelete: () => Promise<void>;
}

/** Deletes after a second question. */
export function DeleteButton({ label, question, onDelete }: Properties) {
  const [asked, setAsked] = useState(false);
  const [error, setError] = useState<unknown>(null);
  if (!asked)
    return (
      <button type="button" class="danger" onClick={() => setAsked(true)}>
        {label}
      </button>
    );
  return (
    <div class="note" role="group" aria-label={label}>
      <p>{question}</p>
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
