import { useState } from "preact/hooks";

import { texts } from "../texts";
import { bytesText } from "../ui/bytes";
import type { ChosenFile } from "./choose";
import { remarkOn, totalBytes } from "./choose";

interface Properties {
  files: readonly ChosenFile[];
  busy: boolean;
  onRemove: (files: readonly ChosenFile[]) => void;
}

/** What will be sent: how much, what is to be said of it, and each file, to be removed. */
export function ChosenFiles({ files, busy, onRemove }: Properties) {
  const [open, setOpen] = useState(false);
  if (files.length === 0) return null;
  const remark = remarkOn(files);
  return (
    <>
      <div class="title-row">
        <p role="status">{texts.upload.files(files.length, bytesText(totalBytes(files)))}</p>
        <button type="button" disabled={busy} onClick={() => onRemove(files)}>
          {texts.upload.clear}
        </button>
      </div>
      {remark && <p class="note">{remark}</p>}
      <details onToggle={(event) => setOpen(event.currentTarget.open)}>
        <summary>{texts.upload.showFiles}</summary>
        {open && (
          <ul class="chosen-files">
            {files.map((each) => (
              <li key={each.path} class="title-row">
                <span>{texts.upload.file(each.path, bytesText(each.file.size))}</span>
                <button
                  type="button"
                  disabled={busy}
                  aria-label={texts.upload.removeFile(each.path)}
                  onClick={() => onRemove([each])}
                >
                  {texts.upload.remove}
                </button>
              </li>
            ))}
          </ul>
        )}
      </details>
    </>
  );
}
