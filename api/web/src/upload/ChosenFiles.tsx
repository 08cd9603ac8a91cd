import { texts } from "../texts";
import { bytesText } from "../texts/figures";
import { Button } from "../ui/Button";
import { Icon } from "../ui/Icon";
import type { ChosenFile } from "./choose";
import { isPhoto, remarkOn, totalBytes } from "./choose";
import type { Checks } from "./usePhotoChecks";

interface Properties {
  files: readonly ChosenFile[];
  checks: Checks;
  busy: boolean;
  onRemove: (files: readonly ChosenFile[]) => void;
}

/** What will be sent: how much, what is to be said of it, and each file with its picture, to be removed. */
export function ChosenFiles({ files, checks, busy, onRemove }: Properties) {
  if (files.length === 0) return null;
  const { seen, defects, done } = checks;
  const wordsOf = ({ path }: ChosenFile) =>
    seen.get(path)?.picture === ""
      ? [texts.upload.unreadable]
      : (defects.get(path) ?? []).map((defect) => texts.photos.defects[defect]);
  const doubtful = files.filter((each) => wordsOf(each).length > 0);
  const remark = remarkOn(files);
  return (
    <>
      <div class="title-row">
        <p role="status">
          {texts.upload.files(files.length, bytesText(totalBytes(files)))}{" "}
          {!done && texts.upload.looking(seen.size, files.filter(({ path }) => isPhoto(path)).length)}
        </p>
        <Button disabled={busy} onClick={() => onRemove(files)} text={texts.upload.clear} />
      </div>
      {remark && <p class="note">{remark}</p>}
      {done && doubtful.length > 0 && (
        <div class="note title-row">
          <p role="status">{texts.upload.doubtful(doubtful.length)}</p>
          <Button disabled={busy} onClick={() => onRemove(doubtful)} text={texts.upload.removeDoubtful} />
        </div>
      )}
      <ul class="chosen-files" aria-label={texts.upload.chosen}>
        {files.map((each) => (
          <li key={each.path}>
            {seen.get(each.path)?.picture ? (
              <img src={seen.get(each.path)?.picture} alt="" />
            ) : (
              <span class="no-picture">
                <Icon name="photos" />
              </span>
            )}
            <span class="file-name" title={each.path}>
              {texts.upload.file(each.path, bytesText(each.file.size))}
            </span>
            {wordsOf(each).map((word) => (
              <span key={word} class="state failed">
                {word}
              </span>
            ))}
            <button
              type="button"
              disabled={busy}
              title={texts.upload.remove}
              aria-label={texts.upload.removeFile(each.path)}
              onClick={() => onRemove([each])}
            >
              <Icon name="absent" />
            </button>
          </li>
        ))}
      </ul>
    </>
  );
}
