import { mayDo } from "../api/roles";
import { serverStatus } from "../api/serverCalls";
import { texts } from "../texts";
import { ErrorNote, Loading } from "../ui/parts";
import { useLoaded } from "../ui/useLoaded";
import { Abilities } from "./Abilities";
import { JobList } from "./JobList";
import { KeyPanel } from "./KeyPanel";
import { KnownNamePanel } from "./KnownNamePanel";

const PAUSE_MS = 10_000;

/** What the server can do, its jobs, and for admins who may call it: only what the caller's role may see. */
export function ServerPage() {
  const { value: status, error, reload } = useLoaded(serverStatus, [], () => PAUSE_MS);
  return (
    <section class="server" aria-labelledby="server-title">
      <h1 id="server-title">{texts.server.title}</h1>
      {error !== null && <ErrorNote error={error} onRetry={reload} />}
      {status === null && error === null && <Loading />}
      {status && (
        <>
          <Abilities status={status} />
          <JobList canChange={mayDo(status.role, "editor")} onChange={reload} />
          {mayDo(status.role, "admin") && <KeyPanel role={status.role} />}
          <KnownNamePanel canDelete={mayDo(status.role, "admin")} />
        </>
      )}
    </section>
  );
}
