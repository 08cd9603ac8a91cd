import type { MutableRef } from "preact/hooks";
import { useEffect, useRef, useState } from "preact/hooks";

import { texts } from "../texts";
import { Icon } from "../ui/Icon";
import { aspectOf, CameraBound } from "../viewer/cameraBound";
import { CameraMotion } from "../viewer/cameraMotion";
import { Controls } from "../viewer/controls";
import { firstView, parseView } from "../viewer/poses";
import { sightingsOf } from "../viewer/seenField";
import { SplatView } from "../viewer/splatView";
import { readSpz } from "../viewer/spz";
import { fromBase64, statesOf } from "../viewer/states";
import type { Sight } from "../viewer/viewpoints";
import { viewOfSight } from "../viewer/viewpoints";
import { webgl } from "../viewer/webgl";
import type { SceneData } from "./data";
import { parameter } from "./data";

/** Moves the camera to where something is seen best. */
export type FlyTo = (sight: Sight) => void;

interface Properties {
  data: SceneData;
  /** Bytes by row, 1 for what glows; null for nothing. */
  found: Uint8Array | null;
  flyTo: MutableRef<FlyTo>;
}

/** The scene of this file in 3D, with what was found in a color of its own. */
export function OfflineViewer({ data, found, flyTo }: Properties) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const [view, setView] = useState<SplatView | null>(null);
  const [problem, setProblem] = useState("");
  const goHome = useRef<() => void>(() => undefined);

  useEffect(() => {
    const element = canvas.current;
    if (!element) return;
    let made: SplatView | null = null;
    const start = firstView(data.cameras);
    const camera = new CameraMotion(parseView(parameter("view"), start.up) ?? start, (now, resting) =>
      made?.setView(now, resting),
    );
    let bound: CameraBound | null = null;
    flyTo.current = (sight) => {
      const size = { width: element.clientWidth, height: element.clientHeight };
      camera.flyTo(viewOfSight(sight, data.cameras, camera.view, size, (view) => bound?.shows(view) ?? true));
    };
    goHome.current = () => camera.flyTo(start);
    const controls = new Controls(element, camera, goHome.current, (gesture) => bound?.bounded(gesture) ?? gesture(1));
    const resize = () => {
      const ratio = Math.min(window.devicePixelRatio, 2);
      made?.setSize(Math.round(element.clientWidth * ratio), Math.round(element.clientHeight * ratio));
    };
    const observer = new ResizeObserver(resize);
    observer.observe(element);
    const splat = readSpz(new Blob([fromBase64(data.splat)]).stream(), () => undefined);
    const gl = webgl(element);
    if (!gl) setProblem(texts.offline.noWebGL);
    else
      void SplatView.create(element, gl).then(async (created) => {
        made = created;
        made.setView(camera.view);
        resize();
        const read = await splat;
        made.setSplat(read);
        bound = new CameraBound(sightingsOf(read, data.cameras), data.cameras, () => aspectOf(element));
        setView(made);
      });
    return () => {
      observer.disconnect();
      controls.destroy();
      camera.stop();
      made?.destroy();
    };
  }, [data, flyTo]);

  useEffect(() => {
    if (!view) return;
    view.setStates(statesOf(data.gaussians, found, null, 0, []), found !== null);
    if (canvas.current) canvas.current.dataset["shown"] = found ? "answer" : "plain";
  }, [view, found, data]);

  return (
    <div class="stage">
      <div class="toolbar" role="group" aria-label={texts.scene.tools}>
        <button type="button" class="tool" onClick={() => goHome.current()}>
          <Icon name="home" />
          {texts.scene.home}
        </button>
        <details>
          <summary>
            <Icon name="help" />
            {texts.scene.help}
          </summary>
          <p class="tool-help" id="canvas-help">
            {texts.scene.canvasHelp}
          </p>
        </details>
      </div>
      <section class="viewer" aria-label={texts.scene.canvas}>
        <canvas
          ref={canvas}
          tabIndex={0}
          role="application"
          aria-label={texts.scene.canvas}
          aria-describedby="canvas-help"
        />
        {(problem || !view) && (
          <p class="viewer-note" role="status">
            {problem || texts.loading}
          </p>
        )}
      </section>
    </div>
  );
}
