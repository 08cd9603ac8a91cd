import type { ComponentChildren } from "preact";
import { useState } from "preact/hooks";

import { texts } from "../texts";
import { Button } from "./Button";

/** A text to be taken elsewhere: to be selected, and copied where there is a clipboard; more buttons stand beside it. */
export function CopyField({ label, text, children }: { label: string; text: string; children?: ComponentChildren }) {
  const [copied, setCopied] = useState("");
  const copy = () =>
    navigator.clipboard.writeText(text).then(
      () => setCopied(text),
      () => undefined, // it can still be selected
    );
  return (
    <>
      <label>
        {label}
        <input readOnly value={text} onFocus={(event) => event.currentTarget.select()} />
      </label>
      <div class="buttons">
        {window.isSecureContext && ( // elsewhere there is no clipboard
          <Button onClick={() => void copy()} text={copied === text ? texts.copied : texts.copy} />
        )}
        {children}
      </div>
    </>
  );
}
