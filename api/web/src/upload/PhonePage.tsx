import { linkRefused, uploadKey } from "../address/uploadLink";
import { getOperation } from "../api/calls";
import { serverStatus } from "../api/serverCalls";
import { JobError } from "../jobs/JobPanel";
import { LeftOutFiles } from "../jobs/LeftOutFiles";
import { duration, stageCountdown } from "../jobs/timing";
import { useTimeLeft } from "../jobs/useTimeLeft";
import { texts } from "../texts";
import { ErrorNote, Loading } from "../ui/parts";
import { useLoaded } from "../ui/useLoaded";
import { UploadPage } from "./UploadPage";

const PAUSE_MS = 2_000;

/** What a link for one upload opens: the upload, and then how its job goes on. */
export function PhonePage() {
  const { value, error, reload } = useLoaded(serverStatus, [uploadKey.value]);
  if (linkRefused.value || !uploadKey.value)
    return (
      <section class="sheet">
        <h1>{texts.phone.invalid}</h1>
        <p>{texts.phone.invalidHelp}</p>
      </section>
    );
  if (!value)
    return (
      <section class="sheet">
        <h1 class="sr-only">{texts.loading}</h1>
        {error === null ? <Loading /> : <ErrorNote error={error} onRetry={reload} />}
      </section>
    );
  if (value.upload_operation) return <PhoneJob operationId={value.upload_operation} />;
  return <UploadPage onCreated={reload} />;
}

function PhoneJob({ operationId }: { operationId: string }) {
  const { value, error } = useLoaded(
    (signal) => getOperation(operationId, signal),
    [operationId],
    (operation) => (operation?.done ? null : PAUSE_MS),
  );
  const stage = value?.stages.at(-1);
  const left = useTimeLeft((previous, now) => stageCountdown(previous, stage, now), !value?.done);
  return (
    <section class="sheet">
      <h1>{texts.phone.arrived}</h1>
      <p>{texts.phone.arrivedHelp}</p>
      {error !== null && <ErrorNote error={error} />}
      {value && <p role="status">{texts.server.states[value.state]}</p>}
      <LeftOutFiles files={value?.left_out} />
      {value && <JobError operation={value} />}
      {value && !value.done && stage && (
        <div>
          <p>{texts.job.stages[stage.stage] ?? stage.stage}</p>
          <progress max={1} value={stage.fraction} aria-label={texts.job.stages[stage.stage] ?? stage.stage} />
          {left !== null && <p class="hint">{texts.job.left(duration(left))}</p>}
        </div>
      )}
    </section>
  );
}
