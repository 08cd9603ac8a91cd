import { useEffect, useRef, useState } from "preact/hooks";

import { type Countdown, secondsLeft } from "./timing";

const TICK_MS = 1_000;

/** Seconds that are left by a countdown, which is drawn anew every second while it is watched. */
export function useTimeLeft(
  next: (previous: Countdown | null, now: number) => Countdown,
  watched: boolean,
): number | null {
  const [, setTick] = useState(0);
  const countdown = useRef<Countdown | null>(null);
  useEffect(() => {
    if (!watched) return;
    const timer = window.setInterval(() => setTick((tick) => tick + 1), TICK_MS);
    return () => window.clearInterval(timer);
  }, [watched]);
  const now = performance.now() / 1_000;
  countdown.current = next(countdown.current, now);
  return secondsLeft(countdown.current, now);
}
