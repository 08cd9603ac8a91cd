import { batch, untracked, useComputed, useSignalEffect } from "@preact/signals";
import { useEffect, useMemo, useRef, useState } from "preact/hooks";

import { go, replaceAddress, route, sceneAddress } from "../address/router";
import { isShared } from "../address/share";
import { deleteScene } from "../api/calls";
import { DraftNote } from "../jobs/DraftNote";
import { JobFigures, JobPanel } from "../jobs/JobPanel";
import { useJob } from "../jobs/useJob";
import { PhotosPanel } from "../photos/PhotosPanel";
import { photosRound } from "../photos/photosRound";
import { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { DeleteButton } from "../ui/DeleteButton";
import { ErrorNote, Loading } from "../ui/parts";
import type { LookAt } from "../viewer/poses";
import { firstView, lookFrom, parseView, viewText } from "../viewer/poses";
import { SceneName } from "./SceneName";
import { ScenePanel } from "./ScenePanel";
import { Toolbar } from "./Toolbar";
import type { ViewerHandle } from "./Viewer";
import { Viewer } from "./Viewer";

const WATCH_MS = 1_500;
const NOTICE_MS = 4_000;

/** One scene: its job while it is made, then its 3D view, questions and objects. */
export function ScenePage({ sceneId }: { sceneId: string }) {
  const state = useMemo(() => new SceneState(sceneId), [sceneId]);
  const viewer = useRef<ViewerHandle | null>(null);
  const view = useRef<LookAt | null>(null);
  const [first] = useState(route.value.page === "scene" ? route.value.view : "");
  const [changed, setChanged] = useState(false);

  const [leaving, setLeaving] = useState(false); // what becomes of the job of a scene that goes is no news
  useJob(state, !leaving);

  const note = () => {
    const current = route.peek();
    if (current.page !== "scene" || current.sceneId !== sceneId) return; // the person has left meanwhile
    const more = {
      text: state.text.peek().trim(),
      version: state.askedVersion.peek(),
      view: view.current ? viewText(view.current) : first,
      objects: state.selected.peek(),
      look: state.look.text,
    };
    replaceAddress(sceneAddress(sceneId, more));
  };

  useEffect(() => {
    void state.refresh();
    return () => state.close();
  }, [state]);

  // Follow the address: it may be changed by hand, by a link, or by "back".
  useSignalEffect(() => {
    const current = route.value;
    if (current.page !== "scene" || current.sceneId !== sceneId) return;
    // What becomes of it later must not bring back what the address said.
    untracked(() => {
      batch(() => {
        state.askedVersion.value = current.version;
        state.selected.value = current.objects;
        if (current.text) state.tab.value = "ask";
        else if (current.objects.length > 0) state.tab.value = "objects";
      });
      if (current.text !== state.text.value.trim()) void state.ask(current.text);
      if (current.view) viewer.current?.flyTo((now) => parseView(current.view, now.up) ?? now);
    });
  });

  const ready = useComputed(() => Boolean(state.scene.value?.version));
  // The version on show has come to be known, or is another one.
  useSignalEffect(() => {
    const version = state.version.value;
    if (!version || !ready.value) return;
    const start = firstView(state.scene.peek()?.cameras ?? []);
    // The question of the address is asked from where the 3D view will begin.
    if (!state.change.view.peek()) state.change.view.value = parseView(first, start.up) ?? start;
    void state.loadObjects();
    void state.ask(state.text.peek());
  });

  useSignalEffect(() => {
    const [objects] = [state.objects.value, state.selected.value];
    if (objects) note();
  });

  useEffect(() => {
    const timer = window.setInterval(() => {
      if (document.hidden) return;
      if (state.scene.value === null) void state.refresh();
    }, WATCH_MS);
    const slow = window.setInterval(() => {
      if (!document.hidden)
        state.notice().then(
          (is) => is && setChanged(true),
          () => undefined, // the header says that the server cannot be reached
        );
    }, NOTICE_MS);
    return () => {
      window.clearInterval(timer);
      window.clearInterval(slow);
    };
  }, [state]);

  const scene = state.scene.value;
  if (!scene)
    return state.error.value !== null ? (
      <section class="sheet">
        <h1>{texts.scene.unavailable}</h1>
        <ErrorNote error={state.error.value} onRetry={() => void state.refresh()} advises={false} />
        <a href="#/">{texts.scene.back}</a>
      </section>
    ) : (
      <section class="sheet">
        <h1 class="sr-only">{texts.loading}</h1>
        <Loading />
      </section>
    );
  const name = scene.name || texts.scenes.untitled;
  const remove = (
    <DeleteButton
      label={texts.scene.remove}
      question={texts.scene.removeQuestion(name)}
      onDelete={async () => {
        setLeaving(true);
        try {
          await deleteScene(sceneId);
          go("#/");
        } catch (error) {
          setLeaving(false);
          throw error;
        }
      }}
    />
  );
  if (!scene.version)
    return (
      <section class="sheet">
        <SceneName scene={scene} onChange={() => state.refresh()} />
        {state.operation.value && (
          <div class="watched">
            <JobPanel operation={state.operation.value} onChange={() => void state.refresh()} />
            <JobFigures operation={state.operation.value} />
          </div>
        )}
        {!isShared && <PhotosPanel sceneId={sceneId} ready={false} round={photosRound(state.operation.value)} />}
        {!isShared && remove}
      </section>
    );
  return (
    <div class="scene">
      <div class="stage">
        <Toolbar state={state} onHome={() => viewer.current?.goHome()} />
        <Viewer
          state={state}
          first={first}
          handle={viewer}
          onView={(moved) => {
            view.current = moved;
            note();
          }}
        />
        <DraftNote scene={scene} operation={state.operation.value} onChange={() => void state.refresh()} />
      </div>
      <ScenePanel
        state={state}
        scene={scene}
        changed={changed}
        view={() => {
          const start = firstView(scene.cameras);
          return view.current ?? parseView(first, start.up) ?? start;
        }}
        onAsk={note}
        onFly={(middle, size, views) => viewer.current?.flyToSight({ middle, size, views })}
        onStand={(camera) => viewer.current?.flyTo((now) => lookFrom(camera, now))}
        remove={remove}
      />
    </div>
  );
}
