import { useEffect, useRef, useState } from "preact/hooks";

import { getScene, renderPicture } from "../api/calls";
import { isAbort } from "../api/http";
import type { PosedCamera, SceneSummary } from "../api/types";
import { texts } from "../texts";

const WIDTH = 360;
const AT_ONCE = 2;

const pictures = new Map<string, string>(); // object URLs by scene and version: a version never changes
const waiting: (() => void)[] = [];
let running = 0;

/** A picture of a ready scene from its first camera; loaded when it comes into sight. */
export function Thumbnail({ scene, name }: { scene: SceneSummary; name: string }) {
  const id = `${scene.id} ${scene.version}`;
  const [address, setAddress] = useState(pictures.get(id) ?? "");
  const frame = useRef<HTMLSpanElement>(null);
  const ready = scene.state === "READY";
  useEffect(() => {
    const known = pictures.get(id);
    setAddress(known ?? "");
    if (!ready || known || !frame.current) return;
    const controller = new AbortController();
    const observer = new IntersectionObserver((entries) => {
      if (!entries.some((entry) => entry.isIntersecting)) return;
      observer.disconnect();
      void inTurn(async () => {
        try {
          const picture = await load(scene.id, controller.signal);
          if (!picture) return;
          pictures.set(id, URL.createObjectURL(picture));
          if (!controller.signal.aborted) setAddress(pictures.get(id) ?? "");
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
  }, [id, ready, scene.id]);
  return (
    <span class="thumbnail" ref={frame}>
      {address && <img src={address} alt={texts.scenes.pictureOf(name)} />}
    </span>
  );
}

async function load(sceneId: string, signal: AbortSignal): Promise<Blob | null> {
  const { cameras } = await getScene(sceneId, signal);
  const [first] = cameras;
  return first ? renderPicture(sceneId, narrowed(first), signal) : null;
}

/** The same camera with a picture of at most `WIDTH` pixels across. */
export function narrowed(camera: PosedCamera): PosedCamera {
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
