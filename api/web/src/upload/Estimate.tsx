import { estimateJob } from "../api/serverCalls";
import { duration } from "../jobs/timing";
import { texts } from "../texts";
import { useLoaded } from "../ui/useLoaded";
import type { ChosenFile } from "./choose";
import { isPhoto } from "./choose";
import type { Checks } from "./usePhotoChecks";

interface Properties {
  files: readonly ChosenFile[];
  checks: Checks;
  preset: string;
}

/** How long a scene of these photos takes on this server; of anything else that is not known before it is sent. */
export function Estimate({ files, checks, preset }: Properties) {
  const known = checks.done && files.every(({ path }) => isPhoto(path));
  const usable = files.filter(({ path }) => checks.seen.get(path)?.picture !== "").length;
  return known && usable > 0 ? <Told photos={usable} checks={checks} preset={preset} /> : null;
}

function Told({ photos, checks, preset }: { photos: number; checks: Checks; preset: string }) {
  const [first] = [...checks.seen.values()].filter(({ width }) => width > 0);
  const [width, height] = [first?.width ?? 0, first?.height ?? 0];
  const { value } = useLoaded(
    (signal) => estimateJob({ photos, width, height, preset }, signal),
    [photos, width, height, preset],
  );
  return value && <p role="status">{texts.upload.takes(duration(value.seconds))}</p>;
}
