import { useEffect, useState } from "preact/hooks";

import { send } from "../api/http";
import type { Operation } from "../api/types";
import { texts } from "../texts";
import { duration } from "./timing";

type Info = NonNullable<Operation["preview"]>;

/** The newest picture of a scene that is being trained; the one before stays until the next is there. */
export function JobPreview({ operationId, info }: { operationId: string; info: Info }) {
  const [shown, setShown] = useState<{ address: string; info: Info } | null>(null);
  useEffect(() => {
    const controller = new AbortController();
    void load(operationId, controller.signal).then(
      (address) => {
        if (controller.signal.aborted) URL.revokeObjectURL(address);
        else setShown({ address, info });
      },
      () => undefined, // the next picture will do
    );
    return () => controller.abort();
  }, [operationId, info.number]); // eslint-disable-line react-hooks/exhaustive-deps -- info is a new object at each report
  useEffect(() => () => (shown ? URL.revokeObjectURL(shown.address) : undefined), [shown]);
  if (!shown) return null;
  const { step, seconds, gaussians, psnr } = shown.info;
  return (
    <figure class="job-figure">
      <img
        src={shown.address}
        width={shown.info.width}
        height={shown.info.height}
        alt={texts.jobWatching.pictureAlt}
        data-step={step}
      />
      <figcaption class="hint">
        {[
          texts.jobWatching.steps(step, duration(seconds)),
          texts.scenes.gaussians(gaussians),
          psnr === null ? "" : texts.scene.psnr(psnr),
        ]
          .filter(Boolean)
          .join(" · ")}
      </figcaption>
    </figure>
  );
}

async function load(operationId: string, signal: AbortSignal): Promise<string> {
  const response = await send(`v1/operations/${encodeURIComponent(operationId)}/preview.jpg`, { signal });
  return URL.createObjectURL(await response.blob());
}
