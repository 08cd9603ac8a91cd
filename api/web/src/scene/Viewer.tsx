import { useSignal, useSignalEffect } from "@preact/signals";
import type { MutableRef } from "preact/hooks";
import { useEffect, useMemo, useRef, useState } from "preact/hooks";

import { splatPath } from "../api/calls";
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
import { Button } from "../ui/Button";
import { ErrorNote } from "../ui/parts";
import type { Gesture } from "../viewer/cameraBound";
import { aspectOf, CameraBound } from "../viewer/cameraBound";
import { CameraMotion } from "../viewer/cameraMotion";
import { Controls } from "../viewer/controls";
import { firstTouch } from "../viewer/firstTouch";
import { LoadedSplats } from "../viewer/loadedSplats";
import type { LookAt } from "../viewer/poses";
import { between, firstView, orbit, parseView, rescaled, viewText } from "../viewer/poses";
import type { SeenSplat } from "../viewer/readSplat";
import { readSplat } from "../viewer/readSplat";
import type { SplatView } from "../viewer/splatView";
import { statesOf } from "../viewer/states";
import type { Sight } from "../viewer/viewpoints";
import { viewOfSight } from "../viewer/viewpoints";
import { webgl } from "../viewer/webgl";
import { Pointing } from "./pointing";
import { Walking } from "./walking";

const QUIET_MS = 8_000; // without a gesture, with the server's picture, until the scene is loaded all the same
const SWAYS = [15, 10, 5].map((degrees) => (degrees * Math.PI) / 180); // the widest is taken that shows what was seen

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
  const picture = useRef<HTMLDivElement>(null);
  const serverView = useSignal<ServerView | null>(null); // until the browser draws, or where it cannot
  /** Whether the scene itself is loaded, and what draws it; a person who only looks is shown the server's picture. */
  const drawing = useSignal<"still" | "webgl" | "server">("still");
  const read = useSignal<SeenSplat | null>(null);
  const bound = useSignal<CameraBound | null>(null);
  const [unseen, setUnseen] = useState(false);
  const motion = useRef<CameraMotion | null>(null);
  const splats = useMemo(() => new LoadedSplats(), []);
  const home = useRef<LookAt | null>(null);
  const flownTo = useRef("");
  const touched = useRef<AbortSignal | null>(null); // aborted by the person's first gesture
  const unbounded = useRef<LookAt | null>(null); // where gestures began before it was known what photos saw
  const shownUnit = useRef(1); // meters by a unit of the trained scene
  const latest = useRef(onView);
  latest.current = onView;

  useEffect(() => {
    const [element, place] = [canvas.current, picture.current];
    const scene = state.scene.peek();
    if (!element || !place || !scene) return;
    const start = firstView(scene.cameras);
    home.current = start;
    shownUnit.current = scene.scaling?.meters_per_unit ?? 1;
    let view: SplatView | null = null;
    let gone = false;
    const isGone = () => gone;
    const camera = new CameraMotion(parseView(first, start.up) ?? start, (now, resting) => {
      view?.setView(now, resting);
      serverView.peek()?.setView(now, resting);
      state.look.moved(now, resting);
      state.change.view.value = now;
      element.dataset["view"] = viewText(now);
      if (!resting) return;
      // What was flown to a photo shows, be it at its edge.
      setUnseen(viewText(now) !== flownTo.current && (bound.peek()?.showsNothing(now) ?? false));
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
        const goal = viewOfSight(sight, cameras, camera.view, sizeNow(), shown);
        flownTo.current = viewText(goal);
        camera.flyTo(goal);
      },
    };
    const walking = new Walking(element, state);
    const bounded = (gesture: Gesture) => {
      if (state.change.brush.peek()) return gesture(0);
      if (!bound.peek()) unbounded.current ??= gesture(0);
      return bound.peek()?.bounded(gesture) ?? gesture(1);
    };
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
    let quiet = 0;
    const begunAfter = (wait: number) => (quiet ||= window.setTimeout(() => void begin().catch(setError), wait));
    const drawn = new ServerView(place, scene, (shown, problem) => {
      begunAfter(QUIET_MS); // not before: what draws the picture may be the same machine
      setError(problem);
      if (!shown) return;
      setShare(null);
      element.dataset["pictures"] = String(Number(element.dataset["pictures"] ?? 0) + 1);
      markShown(element, state.geometry.peek(), shown.found.length > 0, shown.hovered);
    });
    serverView.value = drawn;
    drawn.setView(camera.view, true);
    const observer = new ResizeObserver(resize);
    observer.observe(element);
    const touch = firstTouch();
    touched.current = touch.signal;
    const begin = async () => {
      window.clearTimeout(quiet);
      if (isGone() || drawing.peek() !== "still") return;
      const gl = webgl(element);
      drawing.value = gl ? "webgl" : "server";
      if (!gl) return;
      // The engine is large, and software that draws in place of graphics slow: the page is there before both.
      const { SplatView } = await import("../viewer/splatView");
      const made = await SplatView.create(element, gl);
      if (isGone()) {
        made.destroy();
        return;
      }
      view = made;
      view.setView(camera.view);
      resize();
      splatView.value = made;
    };
    if (state.look.mode.peek() !== "photo") begunAfter(0);
    touch.signal.addEventListener("abort", () => void begin().catch(setError));
    return () => {
      gone = true;
      window.clearTimeout(quiet);
      touch.abort();
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

  // Load the Gaussians of the version on show, or what photos saw of them, which bounds the camera.
  useSignalEffect(() => {
    const [draws, version] = [drawing.value, state.geometry.value];
    if (draws === "still" || !version) return;
    const controller = new AbortController();
    if (!serverView.peek()) setShare(0);
    const cameras = state.scene.peek()?.cameras ?? [];
    const told = (share: number) => !serverView.peek() && setShare(share);
    const fetched = () => load(state.sceneId, version, cameras, draws === "webgl", controller.signal, told);
    splats.get(`${state.sceneId}/${version}`, fetched).then(
      (loadedSplat) => {
        if (controller.signal.aborted) return;
        const unit = state.scene.peek()?.scaling?.meters_per_unit ?? 1;
        const at = motion.current;
        if (at && home.current && unit !== shownUnit.current) {
          const factor = unit / shownUnit.current;
          home.current = rescaled(home.current, factor);
          at.set(rescaled(at.view, factor));
        }
        shownUnit.current = unit;
        const element = canvas.current;
        if (!element) return;
        bound.value = new CameraBound(loadedSplat.seen, cameras, () => aspectOf(element));
        const [begun, strayed] = [unbounded.current, at?.view];
        unbounded.current = null;
        if (begun && strayed) at?.set(bound.value.farthest((share) => between(begun, strayed, share)));
        setUnseen(at !== null && bound.value.showsNothing(at.view));
        if (draws === "server") element.dataset["drawn"] = draws;
        else read.value = loadedSplat;
      },
      (problem: unknown) => {
        if (!controller.signal.aborted && !isAbort(problem)) setError(problem);
      },
    );
    return () => controller.abort();
  });

  // Draw them in place of the server.
  useSignalEffect(() => {
    const [view, shown] = [splatView.value, read.value];
    if (!view || !shown) return;
    loaded.value = 0; // another splat of as many Gaussians has none of the looks of the one before
    view.setSplat(shown.splat);
    loaded.value = shown.splat.count;
    setShare(null);
    setError(null);
    view.onceDrawn(() => {
      const [server, element, at] = [serverView.peek(), canvas.current, motion.current];
      if (!server || !element) return;
      server.destroy();
      serverView.value = null;
      element.dataset["drawn"] = "webgl";
      if (view.showsDraft) at?.rest(); // and is drawn in full
      const angle = SWAYS.find((each) => [each, -each].every((by) => at && bound.peek()?.shows(orbit(at.view, by, 0))));
      if (angle && at && touched.current) at.sway(angle, touched.current);
    });
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
        (object) => state.change.shows(object),
        lit === "selection" ? part : null,
        going,
      ),
      mask !== null || selected.length > 0,
    );
    if (canvas.current && !serverView.value)
      markShown(canvas.current, state.geometry.value, mask !== null, state.hovered.value);
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
      <div class="server-picture" ref={picture} aria-hidden="true" />
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
          {texts.scene.unseen} <Button onClick={() => handle.current?.goHome()} text={texts.scene.backToSeen} />
        </p>
      )}
      <ToolMarks state={state} />
      <GlowLegend state={state} />
      <Gizmo state={state} />
      {drawing.value === "server" && error === null && (
        <p class="viewer-note server-view-note">{texts.serverView.note}</p>
      )}
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
  draws: boolean,
  signal: AbortSignal,
  progress: (share: number) => void,
) {
  const response = await send(splatPath(sceneId, version, !draws), { signal });
  return readSplat(response.body ?? new ReadableStream(), cameras, draws, progress, signal);
}
