import { useEffect, useRef, useState } from "preact/hooks";

import { getScene, renderPicture } from "../api/calls";
import { isAbort } from "../api/http";
import { listPhotos, photoAddress } from "../api/photoCalls";
import type { Assessment, PosedCamera, SceneSummary } from "../api/types";
import { texts } from "../texts";
import { Icon } from "../ui/Icon";
import { middleCamera } from "../viewer/poses";
import { namesIn } from "./arranged";

const WIDTH = 360;
const AT_ONCE = 2;

/** What a card says once the scene is loaded. */
export interface Told {
  grade: Assessment["grade"] | null;
  /** Names in the scene, those of most Gaussians first. */
  names: readonly string[];
  /** How many objects it has; null where nobody could count them. */
  objects: number | null;
}

interface Shown extends Told {
  address: string;
}

const shown = new Map<string, Shown>(); // by scene and version: a version never changes
const waiting: (() => void)[] = [];
let running = 0;

/** A scene's photo, or its picture where none is stored, of the camera in the middle; loaded when it is in sight. */
export function Thumbnail({
  scene,
  name,
  onLoaded,
}: {
  scene: SceneSummary;
  name: string;
  onLoaded: (told: Told) => void;
}) {
  const id = `${scene.id} ${scene.version}`;
  const [address, setAddress] = useState(shown.get(id)?.address ?? "");
  const frame = useRef<HTMLSpanElement>(null);
  const viewable = scene.version !== ""; // a draft is, too
  const told = useRef(onLoaded);
  told.current = onLoaded;
  useEffect(() => {
    const take = (one: Shown) => {
      setAddress(one.address);
      told.current(one);
    };
    const known = shown.get(id);
    if (known) take(known);
    if (!viewable || known || !frame.current) return;
    const controller = new AbortController();
    const observer = new IntersectionObserver((entries) => {
      if (!entries.some((entry) => entry.isIntersecting)) return;
      observer.disconnect();
      void inTurn(async () => {
        try {
          const one = await load(scene, controller.signal);
          shown.set(id, one);
          if (!controller.signal.aborted) take(one);
        } catch (error) {
          if (!isAbort(error)) setAddress(""); // the card says what the scene is without its picture
        }
      });
    });
    observer.observe(frame.current);
    return () => {
      observer.disconnect();
      controller.abort();
    };
  }, [id, viewable]); // eslint-disable-line react-hooks/exhaustive-deps -- a scene of that id and version never changes
  return (
    <span class="thumbnail" ref={frame}>
      {address ? <img src={address} alt={texts.scenes.pictureOf(name)} /> : <Icon name="photos" />}
    </span>
  );
}

async function load({ id, version }: SceneSummary, signal: AbortSignal): Promise<Shown> {
  const [scene, stored] = await Promise.all([getScene(id, signal), listPhotos(id, version, signal)]);
  const told = {
    grade: scene.assessment?.grade ?? null,
    names: namesIn(scene.dictionary),
    objects: scene.object_count ?? null,
  };
  const camera = middleCamera(scene.cameras);
  if (!camera) return { address: "", ...told };
  if (stored.has(camera.name)) return { address: await photoAddress(id, version, camera.name, true), ...told };
  return { address: URL.createObjectURL(await renderPicture(id, narrowed(camera), signal)), ...told };
}

/** The same camera with a picture of at most `WIDTH` pixels across. */
function narrowed(camera: PosedCamera): PosedCamera {
  const { width, height, fx, fy, cx, cy } = camera.intrinsics;
  const ratio = Math.min(1, WIDTH / width);
  const [w, h] = [Math.max(1, Math.round(width * ratio)), Math.max(1, Math.round(height * ratio))];
  const intrinsics = {
    width: w,
    height: h,
    fx: (fx * w) / width,
    fy: (fy * h) / height,
    cx: (cx * w) / width,
    cy: (cy * h) / height,
  };
  return { ...camera, intrinsics };
}

/** Runs a few tasks at a time: a long list must not occupy the server. */
async function inTurn(task: () => Promise<void>): Promise<void> {
  if (running >= AT_ONCE) await new Promise<void>((start) => waiting.push(start));
  running += 1;
  try {
    await task();
  } finally {
    running -= 1;
    waiting.shift()?.();
  }
}
