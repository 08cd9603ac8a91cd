import { retryOperation } from "../api/calls";
import type { Operation } from "../api/types";
import { texts } from "../texts";
import { Button } from "../ui/Button";

/** Offers to retry a failed or cancelled job, first without the photos to blame or with others. `act` runs calls. */
export function RetryOffer({
  operation,
  busy,
  act,
}: {
  operation: Operation;
  busy: boolean;
  act: (call: (id: string) => Promise<void>) => void;
}) {
  if (operation.state !== "FAILED" && operation.state !== "CANCELLED") return null;
  const photos = operation.error?.photos ?? [];
  const others = photos.length === 0 && operation.error?.recurs === true && operation.kind === "create_scene";
  const again = photos.length === 0 && !others;
  return (
    <span class="buttons">
      {photos.length > 0 && (
        <Button
          class="primary"
          disabled={busy}
          onClick={() => act((id) => retryOperation(id, photos))}
          text={texts.job.leaveOut(photos)}
        />
      )}
      {others && (
        <a class="button primary" href="#/new">
          {texts.job.otherPhotos}
        </a>
      )}
      <Button
        class={again ? "primary" : ""}
        disabled={busy}
        onClick={() => act(retryOperation)}
        text={again ? texts.job.retry : texts.job.retryUnchanged}
      />
    </span>
  );
}
