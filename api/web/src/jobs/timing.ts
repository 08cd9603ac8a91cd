import type { StageProgress } from "../api/types";
import { texts } from "../texts";

const LEAST_FRACTION = 0.02; // before that, a rate says nothing

/** Seconds until a stage ends at its rate so far; null while that cannot be said. */
export function secondsLeft(stage: StageProgress): number | null {
  if (stage.fraction < LEAST_FRACTION || stage.fraction >= 1) return null;
  return (stage.seconds * (1 - stage.fraction)) / stage.fraction;
}

/** Seconds as people say them. */
export function duration(seconds: number): string {
  return seconds < 90 ? texts.job.seconds(Math.round(seconds)) : texts.job.minutes(Math.round(seconds / 60));
}
