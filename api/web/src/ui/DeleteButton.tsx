import { useState } from "preact/hooks";

import { texts } from "../texts";
import { Button } from "./Button";
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
  if (!asked) return <Button class="danger" onClick={() => setAsked(true)} text={label} />;
  return (
    <div class="note" role="group" aria-label={label}>
      <p>{question}</p>
      {error !== null && <ErrorNote error={error} />}
      <div class="buttons">
        <Button
          class="danger"
          onClick={() => {
            setError(null);
            onDelete().catch(setError);
          }}
          text={texts.scene.removeYes}
        />
        <Button onClick={() => setAsked(false)} text={texts.cancel} />
      </div>
    </div>
  );
}
