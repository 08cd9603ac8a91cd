import type { SceneVersion } from "../api/types";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { momentText } from "../texts/figures";
import { Button } from "../ui/Button";
import { describeVersion, lineOf } from "./versionTexts";

/** Every version of the scene, newest first: what made it, when, by whom; any can be restored, or looked at beside. */
export function VersionsPanel({ state }: { state: SceneState }) {
  const versions = state.versions.value;
  const line = lineOf(versions, state.scene.value?.version ?? "");
  return (
    <details class="versions">
      <summary>
        <h2>{texts.change.versions(versions.length)}</h2>
      </summary>
      <p class="hint">{texts.change.versionsHelp}</p>
      <ol>
        {[...versions].reverse().map((version) => (
          <Row key={version.version} state={state} version={version} undone={!line.has(version.version)} />
        ))}
      </ol>
    </details>
  );
}

function Row({ state, version, undone }: { state: SceneState; version: SceneVersion; undone: boolean }) {
  const what = describeVersion(version);
  const compared = state.compared.value === version.version;
  const restore = () => {
    state.compared.value = "";
    void state.restore(version.version, texts.change.restored(what));
  };
  return (
    <li class={undone ? "undone" : undefined} aria-current={version.current ? "true" : undefined}>
      <p>{what}</p>
      <p class="hint">
        {[
          version.current && texts.change.current,
          undone && texts.change.undoneVersion,
          momentText(version.created_at),
          version.author && texts.change.by(version.author),
        ]
          .filter(Boolean)
          .join(" · ")}
      </p>
      {!version.current && (
        <div class="buttons">
          <Button
            aria-pressed={compared}
            aria-label={texts.change.compareWith(what)}
            onClick={() => (state.compared.value = compared ? "" : version.version)}
            text={texts.change.compare}
          />
          <Button
            disabled={state.busy.value}
            aria-label={texts.change.restoreVersion(what)}
            onClick={restore}
            text={texts.change.restore}
          />
        </div>
      )}
    </li>
  );
}

/** While another version is on show. */
export function ComparedNote({ state }: { state: SceneState }) {
  const version = state.versions.value.find((each) => each.version === state.compared.value);
  if (!version) return null;
  return (
    <p class="note tool-note" role="status">
      {texts.change.comparing(describeVersion(version))}{" "}
      <Button class="plain" onClick={() => (state.compared.value = "")} text={texts.change.compareEnd} />
    </p>
  );
}
