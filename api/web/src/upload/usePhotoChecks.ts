import { useEffect, useMemo, useRef, useState } from "preact/hooks";

import type { ChosenFile } from "./choose";
import { isPhoto } from "./choose";
import type { Defect, PhotoQuality } from "./photoQuality";
import { judged } from "./photoQuality";
import type { FromWorker, ToWorker } from "./photoWorker";

/** What the browser sees of a photo. */
interface Seen {
  /** Address of a small picture; empty where the browser cannot read the file, which the server perhaps can. */
  picture: string;
  quality: PhotoQuality | null;
  width: number;
  height: number;
}

export interface Checks {
  seen: ReadonlyMap<string, Seen>;
  /** By path, once all photos have been looked at. */
  defects: ReadonlyMap<string, readonly Defect[]>;
  done: boolean;
}

/** Looks at the chosen photos, each once, in a worker. */
export function usePhotoChecks(files: readonly ChosenFile[]): Checks {
  const worker = useRef<Worker | null>(null);
  const asked = useRef<File[]>([]);
  const pictures = useRef<string[]>([]);
  const [known, setKnown] = useState<ReadonlyMap<File, Seen>>(new Map());
  useEffect(
    () => () => {
      worker.current?.terminate();
      for (const address of pictures.current) URL.revokeObjectURL(address);
    },
    [],
  );
  useEffect(() => {
    for (const { file, path } of files) {
      if (!isPhoto(path) || asked.current.includes(file)) continue;
      if (!worker.current) {
        worker.current = new Worker(new URL("./photoWorker.ts", import.meta.url), { type: "module" });
        worker.current.addEventListener("message", ({ data: { number, seen } }: MessageEvent<FromWorker>) => {
          const looked = asked.current[number];
          if (!looked) return;
          const picture = seen ? URL.createObjectURL(seen.picture) : "";
          pictures.current.push(picture);
          setKnown((before) => new Map(before).set(looked, { quality: null, width: 0, height: 0, ...seen, picture }));
        });
      }
      worker.current.postMessage({ number: asked.current.length, file } satisfies ToWorker);
      asked.current.push(file);
    }
  }, [files]);
  return useMemo(() => {
    const seen = new Map<string, Seen>();
    let done = true;
    for (const { file, path } of files) {
      const one = known.get(file);
      if (one) seen.set(path, one);
      else if (isPhoto(path)) done = false;
    }
    const qualities = new Map([...seen].flatMap(([path, { quality }]) => (quality ? [[path, quality] as const] : [])));
    return { seen, done, defects: done ? judged(qualities) : new Map() };
  }, [files, known]);
}
