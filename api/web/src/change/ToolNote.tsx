import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { ErrorNote } from "../ui/parts";
import { MiddleButton } from "./MiddleButton";
import { endPrompt } from "./prompts";
import { RulerLine, RulerNote } from "./Ruler";
import { ComparedNote } from "./VersionsPanel";

/** Over the picture: what the next click means, and the crosshair for those who do not click. */
export function ToolNote({ state }: { state: SceneState }) {
  const { change } = state;
  const takesPlaces = change.onPlace.value !== null;
  return (
    <>
      <ComparedNote state={state} />
      <PromptNote state={state} />
      <RulerNote state={state} />
      <RulerLine state={state} />
      {takesPlaces && <div class="crosshair" aria-hidden="true" />}
    </>
  );
}

function PromptNote({ state }: { state: SceneState }) {
  const tool = state.change.prompt.value;
  if (!tool) return null;
  const first = tool.kind === "split" ? texts.change.splitClick : texts.change.addClick;
  return (
    <div class="viewer-note tool">
      <p role="status">
        {state.busy.value
          ? texts.change.promptWaits
          : tool.made
            ? texts.change.promptMade(tool.made.id, tool.made.count)
            : first}
      </p>
      {state.actionError.value !== null && <ErrorNote error={state.actionError.value} />}
      <div class="buttons">
        <MiddleButton state={state} />
        {tool.made && (
          <button
            type="button"
            disabled={state.busy.value}
            onClick={() => {
              endPrompt(state);
              void state.undo(texts.things.undone);
            }}
          >
            {texts.change.promptUndo}
          </button>
        )}
        <button type="button" disabled={state.busy.value} onClick={() => endPrompt(state)}>
          {tool.made ? texts.change.promptEnd : texts.cancel}
        </button>
      </div>
    </div>
  );
}
