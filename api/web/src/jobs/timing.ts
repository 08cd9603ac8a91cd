import type { Operation, StageProgress } from "../api/types";
import { texts } from "../texts";

const LEAST_FRACTION = 0.02; // before that, a rate says nothing

/** What was last known of a moment that comes nearer. */
export interface Countdown {
  /** What it was said by; another one is news. */
  readonly key: string;
  /** Seconds that were left then; null where that could not be said. */
  readonly left: number | null;
  /** When that was, seconds of any clock. */
  readonly at: number;
}

/** A stage's end at its rate so far, said anew only when it comes forward: `previous`, or a new countdown. */
export function stageCountdown(previous: Countdown | null, stage: StageProgress | undefined, now: number): Countdown {
  const key = stage ? `${stage.stage} ${stage.fraction}` : "";
  if (previous?.key === key) return previous;
  const known = stage && stage.fraction >= LEAST_FRACTION && stage.fraction < 1;
  return { key, left: known ? (stage.seconds * (1 - stage.fraction)) / stage.fraction : null, at: now };
}

/** A job's end as the server said it: `previous` where it says the same, or a new countdown. */
export function jobCountdown(previous: Countdown | null, left: number | null, now: number): Countdown {
  const key = String(left);
  return previous?.key === key ? previous : { key, left, at: now };
}

/** Seconds that are left now; null where that is not known, or not any more. */
export function secondsLeft(countdown: Countdown, now: number): number | null {
  const left = countdown.left === null ? null : countdown.left - (now - countdown.at);
  return left !== null && left > 0 ? left : null;
}

/** What a job waits for, with how many are ahead of it and for how long, as far as the server knows. */
export function waiting({ jobs_ahead, starts_in_s }: Pick<Operation, "jobs_ahead" | "starts_in_s">): string {
  return texts.job.queued(jobs_ahead ?? 0, starts_in_s ? duration(starts_in_s) : "");
}

/** Seconds as people say them. */
export function duration(seconds: number): string {
  return seconds < 90 ? texts.job.seconds(Math.round(seconds)) : texts.job.minutes(Math.round(seconds / 60));
}
