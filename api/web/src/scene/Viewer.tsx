import { useSignal, useSignalEffect } from "@preact/signals";
import type { MutableRef } from "preact/hooks";
import { useEffect, useMemo, useRef, useState } from "preact/hooks";

import { exportPath } from "../api/calls";
import { isAbort, send } from "../api/http";
import type { PosedCamera } from "../api/types";
import { Gizmo } from "../change/Gizmo";
import { ToolMarks } from "../change/ToolNote";
import { CropBoxLines } from "../improve/CleanUpPanel";
import { HollowCameras } from "../improve/NextPhotos";
import { Frusta } from "../look/Frusta";
import { GlowLegend, Legend } from "../look/Legend";
import { PhotoCompare } from "../look/PhotoCompare";
import { useColors } from "../look/useColors";
import { ServerView } from "../serverView/ServerView";
import { useServerView } from "../serverView/useServerView";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { ErrorNote } from "../ui/parts";
import type { Gesture } from "../viewer/cameraBound";
import { aspectOf, CameraBound } from "../viewer/cameraBound";
import { CameraMotion } from "../viewer/cameraMotion";
import { Controls } from "../viewer/controls";
import { LoadedSplats } from "../viewer/loadedSplats";
import type { LookAt } from "../viewer/poses";
import { firstView, parseView, rescaled, viewText } from "../viewer/poses";
import { readSplat } from "../viewer/readSplat";
import type { SplatView } from "../viewer/splatView";
import { statesOf } from "../viewer/states";
import type { Sight } from "../viewer/viewpoints";
import { viewOfSight } from "../viewer/viewpoints";
import { webgl } from "../viewer/webgl";
import { Pointing } from "./pointing";
import { Walking } from "./walking";

/** What other parts of the page may ask of the 3D view. */
export interface ViewerHandle {
  /** Flies to the first view. */
  goHome(): void;
  /** Moves the camera to where `aim` says, seen from where it is. */
  flyTo(aim: (now: LookAt) => LookAt): void;
  /** Moves it to where something is seen best. */
  flyToSight(sight: Sight): void;
}

interface Properties {
  state: SceneState;
  /** The view of the address; empty: from the scene's first camera. */
  first: string;
  handle: MutableRef<ViewerHandle | null>;
  onView: (view: LookAt) => void;
}

/** The scene in 3D, with what was found, pointed at and selected in colors of their own. */
export function Viewer({ state, first, handle, onView }: Properties) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const splatView = useSignal<SplatView | null>(null);
  const loaded = useSignal(0); // Gaussians on show
  const [share, setShare] = useState<number | null>(0);
  const [error, setError] = useState<unknown>(null);
  const serverView = useSignal<ServerView | null>(null); // where the browser cannot draw
  const bound = useSignal<CameraBound | null>(null);
  const [unseen, setUnseen] = useState(false);
  const motion = useRef<CameraMotion | null>(null);
  const splats = useMemo(() => new LoadedSplats(), []);
  const home = useRef<LookAt | null>(null);
  const shownUnit = useRef(1); // meters by a unit of the trained scene
  const latest = useRef(onView);
  latest.current = onView;

  useEffect(() => {
    const element = canvas.current;
    const scene = state.scene.peek();
    if (!element || !scene) return;
    const start = firstView(scene.cameras);
    home.current = start;
    shownUnit.current = scene.scaling?.meters_per_unit ?? 1;
    let view: SplatView | null = null;
    let gone = false;
    const camera = new CameraMotion(parseView(first, start.up) ?? start, (now, resting) => {
      view?.setView(now, resting);
      serverView.peek()?.setView(now, resting);
      state.look.moved(now, resting);
      state.change.view.value = now;
      element.dataset["view"] = viewText(now);
      if (!resting) return;
      setUnseen(bound.peek()?.showsNothing(now) ?? false);
      latest.current(now);
    });
    motion.current = camera;
    const goHome = () => camera.flyTo(home.current ?? start);
    const sizeNow = () => ({ width: element.clientWidth, height: element.clientHeight });
    handle.current = {
      goHome,
      flyTo: (aim) => camera.flyTo(aim(camera.view)),
      flyToSight: (sight) => {
        const cameras = state.scene.peek()?.cameras ?? [];
        const shown = (view: LookAt) => bound.peek()?.shows(view) ?? true;
        camera.flyTo(viewOfSight(sight, cameras, camera.view, sizeNow(), shown));
      },
    };
    const walking = new Walking(element, state);
    const bounded = (gesture: Gesture) =>
      state.change.brush.peek() ? gesture(0) : (bound.peek()?.bounded(gesture) ?? gesture(1));
    const controls = new Controls(element, camera, goHome, bounded);
    const pointing = new Pointing(element, state, () => camera.view);
    state.look.attach({
      canvas: element,
      level: start.up,
      fly: (goal) => camera.flyTo(goal),
      jump: (goal) => camera.set(goal),
      changed: () => latest.current(camera.view),
    });
    state.look.moved(camera.view, false);
    state.change.view.value = camera.view;
    const resize = () => {
      state.look.resized(sizeNow());
      state.change.size.value = sizeNow();
      const ratio = Math.min(window.devicePixelRatio, 2);
      view?.setSize(Math.round(element.clientWidth * ratio), Math.round(element.clientHeight * ratio));
      serverView.peek()?.setSize(element.clientWidth, element.clientHeight);
    };
    const letServerDraw = () => {
      setShare(null);
      const drawn = new ServerView(element, state.sceneId, (shown, problem) => {
        setError(problem);
        if (shown) markShown(element, state.geometry.peek(), shown.found.length > 0, shown.hovered);
      });
      serverView.value = drawn;
      drawn.setView(camera.view, true);
      resize();
    };
    const observer = new ResizeObserver(resize);
    observer.observe(element);
    const gl = webgl(element);
    if (gl)
      // The engine is large: the page is there before it.
      import("../viewer/splatView")
        .then(({ SplatView }) => SplatView.create(element, gl))
        .then(
          (made) => {
            if (gone) {
              made.destroy();
              return;
            }
            view = made;
            view.setView(camera.view);
            resize();
            splatView.value = made;
          },
          (problem: unknown) => setError(problem),
        );
    else letServerDraw();
    return () => {
      gone = true;
      observer.disconnect();
      walking.destroy();
      controls.destroy();
      pointing.destroy();
      camera.stop();
      state.look.detach();
      handle.current = null;
      view?.destroy();
      serverView.peek()?.destroy();
      splatView.value = serverView.value = null;
    };
  }, [state]); // eslint-disable-line react-hooks/exhaustive-deps -- handle and signals live as long as the viewer

  // Load the Gaussians of the version on show.
  useSignalEffect(() => {
    const [view, version] = [splatView.value, state.geometry.value];
    if (!view || !version) return;
    const controller = new AbortController();
    setShare(0);
    setError(null);
    const cameras = state.scene.peek()?.cameras ?? [];
    const fetched = () => load(state.sceneId, version, cameras, controller.signal, setShare);
    splats.get(`${state.sceneId}/${version}`, fetched).then(
      ({ splat, seen }) => {
        if (controller.signal.aborted) return;
        const unit = state.scene.peek()?.scaling?.meters_per_unit ?? 1;
        const at = motion.current;
        if (at && home.current && unit !== shownUnit.current) {
          const factor = unit / shownUnit.current;
          home.current = rescaled(home.current, factor);
          at.set(rescaled(at.view, factor));
        }
        shownUnit.current = unit;
        loaded.value = 0; // another splat of as many Gaussians has none of the looks of the one before
        view.setSplat(splat);
        loaded.value = splat.count;
        setShare(null);
        const element = canvas.current;
        if (!element) return;
        bound.value = new CameraBound(seen, cameras, () => aspectOf(element));
        setUnseen(motion.current !== null && bound.value.showsNothing(motion.current.view));
      },
      (problem: unknown) => {
        if (!controller.signal.aborted && !isAbort(problem)) setError(problem);
      },
    );
    return () => controller.abort();
  });

  useSignalEffect(() => {
    const [view, count, lit] = [splatView.value, loaded.value, state.lit.value];
    if (!view || !count) return;
    const found = lit === "answer" ? state.found.value : null;
    const mask = found?.length === count ? found : null;
    const selected = lit === "selection" ? state.selected.value : [];
    const owners = state.owners.value?.length === count ? state.owners.value : null;
    const going = state.change.going.value?.length === count ? state.change.going.value : null;
    const part = state.partRows.value?.length === count ? state.partRows.value : null;
    view.setStates(
      statesOf(
        count,
        mask,
        owners,
        view.sparesPictures ? 0 : state.hovered.value,
        selected,
        (thing) => state.change.shows(thing),
        lit === "selection" ? part : null,
        going,
      ),
      mask !== null || selected.length > 0,
    );
    if (canvas.current) markShown(canvas.current, state.geometry.value, mask !== null, state.hovered.value);
  });
  useServerView(serverView, state);

  useColors(state, splatView, loaded, canvas);

  useSignalEffect(() => {
    const motion = state.change.motion.value;
    if (loaded.value) splatView.value?.setMotion(motion);
  });

  return (
    <section class="viewer" aria-label={texts.scene.canvas}>
      <canvas
        ref={canvas}
        tabIndex={0}
        role="application"
        aria-label={texts.scene.canvas}
        aria-describedby="canvas-help"
      />
      <Frusta look={state.look} />
      <HollowCameras look={state.look} />
      <CropBoxLines state={state} />
      <PhotoCompare state={state} />
      <Legend state={state} />
      {share !== null && error === null && (
        <p class="viewer-note" role="status">
          {texts.scene.loading3d(Math.round(share * 100))}
        </p>
      )}
      {unseen && share === null && (
        <p class="viewer-note unseen" role="status">
          {texts.scene.unseen}{" "}
          <button type="button" onClick={() => handle.current?.goHome()}>
            {texts.scene.backToSeen}
          </button>
        </p>
      )}
      <ToolMarks state={state} />
      <GlowLegend state={state} />
      <Gizmo state={state} />
      {serverView.value && error === null && <p class="viewer-note server-view-note">{texts.serverView.note}</p>}
      {error !== null && (
        <div class="viewer-note">
          <ErrorNote error={error} />
        </div>
      )}
    </section>
  );
}

/** Says of a canvas what it shows, for who tests the page. */
function markShown(canvas: HTMLCanvasElement, geometry: string, answered: boolean, hovered: number): void {
  canvas.dataset["shown"] = `${geometry} ${answered ? "answer" : "plain"}`;
  canvas.dataset["hovered"] = String(hovered);
}

async function load(
  sceneId: string,
  version: string,
  cameras: readonly PosedCamera[],
  signal: AbortSignal,
  progress: (share: number) => void,
) {
  const response = await send(exportPath(sceneId, "spz", version), { signal });
  return readSplat(response.body ?? new ReadableStream(), cameras, progress, signal);
}
