import type { ServerHealth, ServerStatus } from "../api/types";
import { duration } from "../jobs/timing";
import { texts } from "../texts";
import { bytesText } from "../texts/figures";
import { CopyField } from "../ui/CopyField";

/** Release, models, workers, limits, and how much room the project has left. */
export function Abilities({ status }: { status: ServerStatus }) {
  const { health } = status;
  const full = status.quotas.filter((quota) => quota.limit !== null && quota.used >= quota.limit);
  const notes = full.map((quota) => texts.quota.full[quota.kind]);
  if (health && health.disk.free_bytes < health.disk.floor_bytes) notes.unshift(texts.server.diskFull);
  if (status.workers === 0) notes.unshift(texts.server.noWorkers);
  return (
    <section class="server-part" aria-labelledby="abilities-title">
      <h2 id="abilities-title">{texts.server.abilities}</h2>
      {notes.map((note) => (
        <p key={note} class="note error" role="status">
          {note}
        </p>
      ))}
      <dl class="facts-list">
        <Fact name={texts.server.version} value={status.version} />
        <Fact name={texts.server.project} value={`${status.project} (${texts.server.roles[status.role]})`} />
        <Fact name={texts.server.workers} value={String(status.workers)} />
        {health && <Health health={health} />}
        <Fact name={texts.server.training} value={texts.server.backends[status.training_backend] ?? ""} />
        <Fact name={texts.server.drawing} value={texts.server.backends[status.backend] ?? ""} />
        {status.quotas.map((quota) => (
          <Fact
            key={quota.kind}
            name={texts.quota.names[quota.kind]}
            value={texts.quota.used(amount(quota.kind, quota.used), quota.limit && amount(quota.kind, quota.limit))}
          />
        ))}
        <Fact name={texts.server.largestUpload} value={bytesText(status.max_upload_bytes)} />
        <Fact name={texts.server.mostImages} value={status.max_images.toLocaleString("en")} />
      </dl>
      <h3>{texts.server.models}</h3>
      <ul class="rows">
        {status.models.map((model) => (
          <li key={model.role}>
            <span class="row-name">{texts.server.modelRoles[model.role]}</span>
            <span>{model.name || texts.server.none}</span>
            <span class={`state ${model.state === "missing" ? "failed" : model.state === "ready" ? "ready" : ""}`}>
              {texts.server.modelStates[model.state]}
              {model.calibrated !== null && ` · ${calibration(model)}`}
            </span>
          </li>
        ))}
      </ul>
      {health && status.models.some(({ role, state }) => role === "open_set_detector" && state === "unset") && (
        <CopyField label={texts.server.anyWord} text="fastsplat models use open-vocabulary" />
      )}
    </section>
  );
}

/** What operators alone are told: silent workers, the queue and the disk. */
function Health({ health: { workers, queue, disk } }: { health: ServerHealth }) {
  return (
    <>
      {workers
        .filter((worker) => !worker.alive)
        .map((worker) => (
          <Fact
            key={`${worker.host} ${worker.pid}`}
            name={texts.server.silentWorker}
            value={texts.server.silentFor(worker.host, worker.pid, duration(worker.silent_s))}
          />
        ))}
      <Fact
        name={texts.server.queue}
        value={texts.server.queued(queue.waiting, queue.running, queue.waits_s === null ? "" : duration(queue.waits_s))}
      />
      <Fact
        name={texts.server.disk}
        value={texts.server.free(bytesText(disk.free_bytes), bytesText(disk.total_bytes))}
      />
    </>
  );
}

function calibration({ role, calibrated }: ServerStatus["models"][number]): string {
  if (calibrated) return texts.server.calibrated;
  return role === "lexicon" ? texts.server.lexiconUnused : texts.server.uncalibrated;
}

function Fact({ name, value }: { name: string; value: string }) {
  return (
    <div>
      <dt>{name}</dt>
      <dd>{value}</dd>
    </div>
  );
}

function amount(kind: string, count: number): string {
  return kind === "bytes" ? bytesText(count) : count.toLocaleString("en");
}
