import { useState } from "preact/hooks";

import type { SceneObject } from "../api/types";
import { BestPhotos } from "../look/BestPhotos";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { Chip } from "../ui/Chip";
import { Form } from "../ui/fields";
import { boxSize, centerOf } from "../viewer/boxes";
import type { Vec } from "../viewer/vectors";
import { AskKind } from "./AskKind";
import { naming, othersSaying } from "./suggested";
import { wordsOf } from "./words";

interface Properties {
  state: SceneState;
  onFly: (middle: Vec, size: number) => void;
}

/** What is selected: its name, edited in place, its figures, and what can be done with it. */
export function ObjectPanel({ state, onFly }: Properties) {
  const objects = state.selectedObjects.value;
  const [object] = objects;
  const merge = () =>
    void state
      .edit({ action: "merge", object_ids: objects.map((each) => each.id) }, texts.objects.merged)
      .then((done) => {
        if (done && object) state.select(object.id);
      });
  if (objects.length === 0) return null;
  return (
    <section class="object" aria-label={texts.objects.selected(objects.length)}>
      {objects.length > 1 && (
        <div class="object-card">
          <h2>{texts.objects.selected(objects.length)}</h2>
          <p>{objects.map(texts.objects.titleOf).join(", ")}</p>
          <div class="buttons">
            <Button class="primary" disabled={state.busy.value} onClick={merge} text={texts.objects.merge} />
            <Button onClick={() => state.clearSelection()} text={texts.objects.close} />
          </div>
        </div>
      )}
      {objects.length === 1 && object && <Card key={object.id} state={state} object={object} onFly={onFly} />}
    </section>
  );
}

function Card({ state, object, onFly }: Properties & { object: SceneObject }) {
  // What is typed belongs to the name it was typed over: no effect, which would run after the first keys of a fast typist.
  const [draft, setDraft] = useState({ over: object.name, text: object.name });
  const name = draft.over === object.name ? draft.text : object.name;
  const [others, setOthers] = useState("");
  const aliases = wordsOf(others);
  const entry = state.scene.value?.dictionary.find((each) => each.label === object.name);
  const made = state.made.value;
  const [skipped, setSkipped] = useState("");
  const asksKind = made?.asks_kind && made.version !== skipped && made.edits.some((edit) => edit.name === object.name);
  const { box } = object;
  const act = (edit: Parameters<SceneState["edit"]>[0], message: string) =>
    void state.edit({ ...edit, object_ids: [object.id] }, message);
  const give = (text: string) => {
    const trimmed = text.trim();
    if (!trimmed || (trimmed === object.name && !aliases.length)) return;
    act(naming(object, trimmed, aliases), texts.objects.saved(trimmed));
    setOthers("");
  };
  return (
    <div class="object-card">
      <h2>{texts.objects.titleOf(object)}</h2>
      <Form onSubmit={() => give(name)}>
        <label>
          {texts.objects.name}
          <input
            value={name}
            autocomplete="off"
            onInput={(event) => setDraft({ over: object.name, text: event.currentTarget.value })}
          />
        </label>
        <label>
          {texts.objects.aliases}
          <input value={others} autocomplete="off" onInput={(event) => setOthers(event.currentTarget.value)} />
        </label>
        <Button type="submit" class="primary" disabled={state.busy.value || !name.trim()} text={texts.objects.save} />
      </Form>
      {asksKind && (
        <AskKind state={state} object={object.id} name={object.name} onSkip={() => setSkipped(made.version)} />
      )}
      {entry && entry.aliases.length > 0 && <p class="hint">{texts.objects.alsoCalled(entry.aliases)}</p>}
      {object.suggestions.length > 0 && (
        <>
          <h3>{texts.objects.suggestions}</h3>
          <ul class="chips">
            {object.suggestions.map((suggestion) => (
              <Chip key={suggestion.name} disabled={state.busy.value} onClick={() => give(suggestion.name)}>
                {texts.objects.suggestion(suggestion.name, suggestion.probability, othersSaying(suggestion))}
              </Chip>
            ))}
          </ul>
        </>
      )}
      <p class="hint">
        {[
          object.source && texts.objects.sources[object.source],
          object.name && texts.objects.probability(object.probability),
          texts.scenes.gaussians(object.gaussian_count),
          box && texts.objects.sizeOf([box.size.x, box.size.y, box.size.z], object.meters),
        ]
          .filter(Boolean)
          .join(" · ")}
      </p>
      {object.reads.length > 0 && <p class="hint">{texts.objects.says(object.reads.map((read) => read.text))}</p>}
      <BestPhotos state={state} object={object.id} />
      <div class="buttons">
        {box && <Button onClick={() => onFly(centerOf(box), boxSize(box))} text={texts.objects.lookAt} />}
        {object.name && (
          <Button
            disabled={state.busy.value}
            onClick={() => act({ action: "unname" }, texts.objects.unnamedNow)}
            text={texts.objects.unname}
          />
        )}
        <Button
          disabled={state.busy.value}
          onClick={() => act({ action: "discard" }, texts.objects.discarded)}
          text={texts.objects.discard}
        />
        <Button onClick={() => state.clearSelection()} text={texts.objects.close} />
      </div>
      <p class="hint">{texts.objects.mergeHelp}</p>
    </div>
  );
}
