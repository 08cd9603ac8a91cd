import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { MiddleButton } from "./MiddleButton";
import { endPrompt } from "./prompts";
import { RulerLine, RulerNote } from "./Ruler";
import { ComparedNote } from "./VersionsPanel";

/** What the next click in the view means. */
export function ToolNote({ state }: { state: SceneState }) {
  return (
    <>
      <ComparedNote state={state} />
      <PromptNote state={state} />
      <RulerNote state={state} />
    </>
  );
}

/** Over the picture: what was clicked, and the crosshair for those who do not click. */
export function ToolMarks({ state }: { state: SceneState }) {
  return (
    <>
      <RulerLine state={state} />
      {state.change.onPlace.value !== null && <div class="crosshair" aria-hidden="true" />}
    </>
  );
}

function PromptNote({ state }: { state: SceneState }) {
  const tool = state.change.prompt.value;
  if (!tool) return null;
  const first = tool.kind === "split" ? texts.change.splitClick : texts.change.addClick;
  return (
    <div class="note tool-note">
      <p role="status">
        {state.busy.value
          ? texts.change.promptWaits
          : tool.made
            ? texts.change.promptMade(tool.made.id, tool.made.count)
            : first}
      </p>
      <div class="buttons">
        <MiddleButton state={state} />
        {tool.made && (
          <Button
            disabled={state.busy.value}
            onClick={() => {
              endPrompt(state);
              void state.undo(texts.objects.undone);
            }}
            text={texts.change.promptUndo}
          />
        )}
        <Button
          disabled={state.busy.value}
          onClick={() => endPrompt(state)}
          text={tool.made ? texts.change.promptEnd : texts.cancel}
        />
      </div>
    </div>
  );
}
