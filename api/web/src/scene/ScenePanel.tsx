import type { ComponentChildren } from "preact";
import { useEffect, useRef } from "preact/hooks";

import { sceneAddress } from "../address/router";
import { isShared } from "../address/share";
import type { PosedCamera, Scene } from "../api/types";
import { AskPanel } from "../ask/AskPanel";
import { LookAlikes } from "../change/LookAlikes";
import { MovePanel } from "../change/MovePanel";
import { ScaleFacts } from "../change/Ruler";
import { SceneTools, ObjectTools } from "../change/ObjectTools";
import { ToolNote } from "../change/ToolNote";
import { VersionsPanel } from "../change/VersionsPanel";
import { CleanUpPanel } from "../improve/CleanUpPanel";
import { CompareToday } from "../improve/CompareToday";
import { LookAgain } from "../improve/LookAgain";
import { CaptionerPanel } from "../improve/CaptionerPanel";
import { NextPhotos } from "../improve/NextPhotos";
import { PhotoLook } from "../look/PhotoLook";
import { PhotosPanel } from "../photos/PhotosPanel";
import type { SceneState } from "../state/sceneState";
import { SharedObject } from "../take/SharedObject";
import { TakeAway } from "../take/TakeAway";
import { texts } from "../texts";
import { ObjectList } from "../objects/ObjectList";
import { ObjectPanel } from "../objects/ObjectPanel";
import { ErrorNote } from "../ui/parts";
import { Tabs } from "../ui/Tabs";
import type { LookAt } from "../viewer/poses";
import type { Vec } from "../viewer/vectors";
import { AssessmentNote } from "./AssessmentNote";
import { SceneFacts } from "./SceneFacts";
import { SceneName } from "./SceneName";

interface Properties {
  state: SceneState;
  scene: Scene;
  /** Whether somebody else has changed the scene since it was opened. */
  changed: boolean;
  /** From where the scene is looked at now. */
  view: () => LookAt;
  onAsk: () => void;
  onFly: (middle: Vec, size: number, views?: readonly string[]) => void;
  onStand: (camera: PosedCamera) => void;
  /** What deletes the scene. */
  remove: ComponentChildren;
}

/** A scene's name, how good it is, and four tabs: what is asked, its objects, its photos, what is taken away. */
export function ScenePanel(properties: Properties) {
  const { state, scene, changed } = properties;
  const reload = () => void state.refresh();
  const panel = useRef<HTMLElement>(null);
  const [only] = state.selected.value.length === 1 ? state.selected.value : [];
  useEffect(() => {
    const row = panel.current?.querySelector<HTMLElement>(".tabs");
    // What is selected stands at the top of its tab.
    if (only && panel.current && row && panel.current.scrollTop > row.offsetTop)
      panel.current.scrollTop = row.offsetTop;
  }, [only]);
  return (
    <aside class="panel" ref={panel} aria-label={texts.scene.panel}>
      <div class="panel-head">
        <SceneName scene={scene} onChange={() => state.refresh()} />
        {scene.assessment && <AssessmentNote assessment={scene.assessment} />}
      </div>
      <Tabs
        label={texts.scene.panel}
        active={state.tab.value}
        onSelect={(name) => (state.tab.value = name)}
        tabs={[
          {
            name: "ask",
            title: texts.scene.tabs.ask,
            content: (
              <AskPanel
                state={state}
                onAsk={properties.onAsk}
                onFly={properties.onFly}
                lookAgain={(text) =>
                  !isShared && <LookAgain key={text} sceneId={scene.id} word={text} onDone={reload} />
                }
              />
            ),
          },
          {
            name: "objects",
            title: texts.scene.tabs.objects,
            count: state.objects.value?.filter((object) => object.kind === "object").length,
            content: <Objects {...properties} reload={reload} />,
          },
          { name: "photos", title: texts.scene.tabs.photos, content: <Photos {...properties} /> },
          { name: "share", title: texts.scene.tabs.share, content: <Share {...properties} /> },
        ]}
      >
        <div class="panel-notes">
          <p class="said" role="status">
            {state.message.value}
          </p>
          {state.actionError.value !== null && <ErrorNote error={state.actionError.value} />}
          {!state.isCurrent.value && (
            <p class="note">
              {texts.scene.oldVersion}{" "}
              <a href={sceneAddress(scene.id, { text: state.text.value, objects: state.selected.value })}>
                {texts.scene.toCurrent}
              </a>
            </p>
          )}
          {changed && (
            <p class="note" role="status">
              {texts.scene.changedElsewhere}
            </p>
          )}
          <ToolNote state={state} />
        </div>
      </Tabs>
    </aside>
  );
}

function Objects({ state, scene, onFly, reload }: Properties & { reload: () => void }) {
  if (isShared)
    return (
      <>
        <SharedObject state={state} onFly={onFly} />
        <ObjectList state={state} onFly={onFly} />
        <ScaleFacts state={state} />
      </>
    );
  return (
    <>
      <MovePanel state={state} />
      <LookAlikes state={state} onFly={onFly} />
      <ObjectPanel state={state} onFly={onFly} />
      <ObjectTools state={state} />
      <ObjectList state={state} onFly={onFly} />
      <CaptionerPanel state={state} />
      <SceneTools state={state} />
      <CleanUpPanel state={state} />
      <ScaleFacts state={state} />
      <LookAgain sceneId={scene.id} onDone={reload} />
      <VersionsPanel state={state} />
    </>
  );
}

function Photos({ state, scene, onStand }: Properties) {
  return (
    <>
      <SceneFacts scene={scene} />
      <PhotoLook look={state.look} />
      {!isShared && (
        <>
          <PhotosPanel sceneId={scene.id} ready />
          <CompareToday state={state} />
          <NextPhotos sceneId={scene.id} version={state.version.value} onFly={onStand} />
        </>
      )}
    </>
  );
}

function Share({ state, scene, view, remove }: Properties) {
  return (
    <>
      <TakeAway state={state} scene={scene} view={view} />
      {!isShared && <div class="panel-end">{remove}</div>}
    </>
  );
}
