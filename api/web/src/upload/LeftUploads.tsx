import { sceneAddress } from "../address/router";
import { texts } from "../texts";
import { bytesText } from "../texts/figures";
import { Button } from "../ui/Button";
import { ErrorNote } from "../ui/parts";
import type { Uploading } from "./uploading";
import { leftUploads } from "./uploading";

/** On any page: how far the uploads are whose form has been left, and where their scenes are. */
export function LeftUploads() {
  return (
    <>
      {leftUploads.value.map((upload) => (
        <Left key={upload.id} upload={upload} />
      ))}
    </>
  );
}

function Left({ upload }: { upload: Uploading }) {
  const busy = upload.busy.value;
  const scene = upload.operation.value?.scene_id;
  const close = () => (leftUploads.value = leftUploads.value.filter((each) => each !== upload));
  return (
    <section class="note" aria-label={texts.upload.of(upload.name)}>
      {scene ? (
        <p role="status">
          {texts.upload.arrived(upload.name)}{" "}
          <a href={sceneAddress(scene)} onClick={close}>
            {texts.upload.toScene}
          </a>
        </p>
      ) : (
        <>
          <p>{texts.upload.of(upload.name)}</p>
          <UploadState upload={upload} />
        </>
      )}
      <div class="buttons">
        {!scene && (
          <Button
            onClick={() => (busy ? upload.pause() : void upload.run())}
            text={busy ? texts.upload.pause : texts.upload.resume}
          />
        )}
        {!busy && <Button onClick={close} text={texts.close} />}
      </div>
    </section>
  );
}

/** How much of an upload has been sent, and what stopped it. */
export function UploadState({ upload }: { upload: Uploading }) {
  const { bytes, speed } = upload.sent.value;
  const { total, error } = upload;
  return (
    <>
      <div class="sending">
        <progress max={total} value={bytes} aria-label={texts.upload.progress} />
        <p class="hint">{texts.upload.sending(bytesText(bytes), bytesText(total), bytesText(speed))}</p>
      </div>
      {error.value !== null && <ErrorNote error={error.value} />}
    </>
  );
}
