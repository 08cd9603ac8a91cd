import { useCallback, useEffect, useRef, useState } from "preact/hooks";

import { isAbort } from "../api/http";

interface Loaded<T> {
  value: T | null;
  error: unknown;
  reload: () => void;
}

/** What `load` brings, anew on changed `inputs` and every `pause(value)` ms in sight; an error keeps the last value. */
export function useLoaded<T>(
  load: (signal: AbortSignal) => Promise<T>,
  inputs: readonly unknown[],
  pause: (value: T | null) => number | null = () => null,
): Loaded<T> {
  const [state, setState] = useState<{ value: T | null; error: unknown }>({ value: null, error: null });
  const [round, setRound] = useState(0);
  const latest = useRef({ load, pause });
  latest.current = { load, pause };
  useEffect(() => {
    setState({ value: null, error: null });
  }, inputs); // eslint-disable-line react-hooks/exhaustive-deps -- the caller says what it depends on
  useEffect(() => {
    const controller = new AbortController();
    let timer = 0;
    let value: T | null = null;
    const again = () => {
      const wait = latest.current.pause(value);
      if (wait !== null) timer = window.setTimeout(run, wait);
    };
    const run = () => {
      if (document.hidden && value !== null) {
        again();
        return;
      }
      latest.current.load(controller.signal).then(
        (loaded) => {
          if (controller.signal.aborted) return;
          value = loaded;
          setState({ value: loaded, error: null });
          again();
        },
        (error: unknown) => {
          if (controller.signal.aborted || isAbort(error)) return;
          setState((before) => ({ value: before.value, error }));
          again();
        },
      );
    };
    run();
    return () => {
      controller.abort();
      window.clearTimeout(timer);
    };
  }, [...inputs, round]); // eslint-disable-line react-hooks/exhaustive-deps -- as above
  const reload = useCallback(() => setRound((number) => number + 1), []);
  return { ...state, reload };
}
