import { useSignalEffect } from "@preact/signals";
import { useEffect, useMemo, useRef, useState } from "preact/hooks";

import { deleteScene } from "../api/calls";
import { go, replaceAddress, route, sceneAddress } from "../app/router";
import { AskPanel } from "../ask/AskPanel";
import { JobPanel } from "../jobs/JobPanel";
import { texts } from "../texts";
import { ThingPanel } from "../things/ThingPanel";
import { ThingList } from "../things/ThingList";
import { LookAgainPanel } from "../lookAgain/LookAgainPanel";
import { PhotosPanel } from "../photos/PhotosPanel";
import { photosRound } from "../photos/photosRound";
import { ErrorNote, Loading } from "../ui/parts";
import type { LookAt } from "../viewer/poses";
import { lookAtBox, viewText } from "../viewer/poses";
import type { ViewerHandle } from "../viewer/Viewer";
import { Viewer } from "../viewer/Viewer";
import { DeleteScene } from "./DeleteScene";
import { SceneName } from "./SceneName";
import { SceneFacts } from "./SceneFacts";
import { SceneState } from "./sceneState";

const WATCH_MS = 1_500;
const NOTICE_MS = 4_000;

/** One scene: its job while it is made, then its 3D view, questions and things. */
export function ScenePage({ sceneId }: { sceneId: string }) {
  const state = useMemo(() => new SceneState(sceneId), [sceneId]);
  const viewer = useRef<ViewerHandle | null>(null);
  const view = useRef<LookAt | null>(null);
  const [first] = useState(route.value.page === "scene" ? route.value.view : "");
  const [changed, setChanged] = useState(false);

  useEffect(() => {
    void state.refresh();
    return () => state.close();
  }, [state]);

  // Follow the address: it may be changed by hand, by a link, or by "back".
  useSignalEffect(() => {
    const current = route.value;
    if (current.page !== "scene" || current.sceneId !== sceneId) return;
    state.askedVersion.value = current.version;
  });

  // The version on show has come to be known, or is another one.
  useSignalEffect(() => {
    const version = state.version.value;
    if (!version || state.scene.peek()?.state !== "READY") return;
    void state.loadThings();
    const current = route.peek();
    void state.ask(state.text.peek() || (current.page === "scene" ? current.text : ""));
  });

  useEffect(() => {
    const timer = window.setInterval(() => {
      if (document.hidden) return;
      const done = state.operation.value?.done ?? state.scene.value !== null;
      if (!done || state.scene.value === null) void state.refresh();
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

  const note = () => {
    const more = {
      text: state.text.value.trim(),
      version: state.askedVersion.value,
      view: view.current ? viewText(view.current) : "",
    };
    replaceAddress(sceneAddress(sceneId, more));
  };

  const scene = state.scene.value;
  if (!scene)
    return state.error.value !== null ? (
      <section class="sheet">
        <h1>{texts.scene.unavailable}</h1>
        <ErrorNote error={state.error.value} onRetry={() => void state.refresh()} />
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
    <DeleteScene
      name={name}
      onDelete={async () => {
        await deleteScene(sceneId);
        go("#/");
      }}
    />
  );
  if (scene.state !== "READY")
    return (
      <section class="sheet">
        <SceneName scene={scene} onChange={() => state.refresh()} />
        {state.operation.value && <JobPanel operation={state.operation.value} onChange={() => void state.refresh()} />}
        <PhotosPanel sceneId={sceneId} ready={false} round={photosRound(state.operation.value)} />
        {remove}
      </section>
    );
  return (
    <div class="scene">
      <Viewer
        state={state}
        first={first}
        handle={viewer}
        onView={(moved) => {
          view.current = moved;
          note();
        }}
      />
      <aside class="panel">
        <SceneName scene={scene} onChange={() => state.refresh()} />
        {!state.isCurrent.value && (
          <p class="note">
            {texts.scene.oldVersion}{" "}
            <a href={sceneAddress(sceneId, { text: state.text.value })}>{texts.scene.toCurrent}</a>
          </p>
        )}
        {changed && (
          <p class="note" role="status">
            {texts.scene.changedElsewhere}
          </p>
        )}
        <AskPanel
          state={state}
          onAsk={note}
          onFly={(middle, size) => viewer.current?.flyTo((now) => lookAtBox(now, middle, size))}
        />
        <ThingPanel
          state={state}
          onFly={(middle, size) => viewer.current?.flyTo((now) => lookAtBox(now, middle, size))}
        />
        <ThingList
          state={state}
          onFly={(middle, size) => viewer.current?.flyTo((now) => lookAtBox(now, middle, size))}
        />
        <LookAgainPanel sceneId={sceneId} onDone={() => void state.refresh()} />
        <PhotosPanel sceneId={sceneId} ready />
        <SceneFacts scene={scene} version={state.version.value} />
        {remove}
      </aside>
    </div>
  );
}
