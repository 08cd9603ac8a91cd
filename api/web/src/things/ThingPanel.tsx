import { useState } from "preact/hooks";

import type { SceneThing } from "../api/types";
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
export function ThingPanel({ state, onFly }: Properties) {
  const things = state.selectedThings.value;
  const [thing] = things;
  const merge = () =>
    void state.edit({ action: "merge", thing_ids: things.map((each) => each.id) }, texts.things.merged).then((done) => {
      if (done && thing) state.select(thing.id);
    });
  if (things.length === 0) return null;
  return (
    <section class="thing" aria-label={texts.things.selected(things.length)}>
      {things.length > 1 && (
        <div class="thing-card">
          <h2>{texts.things.selected(things.length)}</h2>
          <p>{things.map(texts.things.titleOf).join(", ")}</p>
          <div class="buttons">
            <Button class="primary" disabled={state.busy.value} onClick={merge} text={texts.things.merge} />
            <Button onClick={() => state.clearSelection()} text={texts.things.close} />
          </div>
        </div>
      )}
      {things.length === 1 && thing && <Card key={thing.id} state={state} thing={thing} onFly={onFly} />}
    </section>
  );
}

function Card({ state, thing, onFly }: Properties & { thing: SceneThing }) {
  // What is typed belongs to the name it was typed over: no effect, which would run after the first keys of a fast typist.
  const [draft, setDraft] = useState({ over: thing.name, text: thing.name });
  const name = draft.over === thing.name ? draft.text : thing.name;
  const [others, setOthers] = useState("");
  const aliases = wordsOf(others);
  const entry = state.scene.value?.dictionary.find((each) => each.label === thing.name);
  const made = state.made.value;
  const [skipped, setSkipped] = useState("");
  const asksKind = made?.asks_kind && made.version !== skipped && made.edits.some((edit) => edit.name === thing.name);
  const { box } = thing;
  const act = (edit: Parameters<SceneState["edit"]>[0], message: string) =>
    void state.edit({ ...edit, thing_ids: [thing.id] }, message);
  const give = (text: string) => {
    const trimmed = text.trim();
    if (!trimmed || (trimmed === thing.name && !aliases.length)) return;
    act(naming(thing, trimmed, aliases), texts.things.saved(trimmed));
    setOthers("");
  };
  return (
    <div class="thing-card">
      <h2>{texts.things.titleOf(thing)}</h2>
      <Form onSubmit={() => give(name)}>
        <label>
          {texts.things.name}
          <input
            value={name}
            autocomplete="off"
            onInput={(event) => setDraft({ over: thing.name, text: event.currentTarget.value })}
          />
        </label>
        <label>
          {texts.things.aliases}
          <input value={others} autocomplete="off" onInput={(event) => setOthers(event.currentTarget.value)} />
        </label>
        <Button type="submit" class="primary" disabled={state.busy.value || !name.trim()} text={texts.things.save} />
      </Form>
      {asksKind && <AskKind state={state} thing={thing.id} name={thing.name} onSkip={() => setSkipped(made.version)} />}
      {entry && entry.aliases.length > 0 && <p class="hint">{texts.things.alsoCalled(entry.aliases)}</p>}
      {thing.suggestions.length > 0 && (
        <>
          <h3>{texts.things.suggestions}</h3>
          <ul class="chips">
            {thing.suggestions.map((suggestion) => (
              <Chip key={suggestion.name} disabled={state.busy.value} onClick={() => give(suggestion.name)}>
                {texts.things.suggestion(suggestion.name, suggestion.probability, othersSaying(suggestion))}
              </Chip>
            ))}
          </ul>
        </>
      )}
      <p class="hint">
        {[
          thing.source && texts.things.sources[thing.source],
          thing.name && texts.things.probability(thing.probability),
          texts.scenes.gaussians(thing.gaussian_count),
          box && texts.things.sizeOf([box.size.x, box.size.y, box.size.z], thing.meters),
        ]
          .filter(Boolean)
          .join(" · ")}
      </p>
      {thing.reads.length > 0 && <p class="hint">{texts.things.says(thing.reads.map((read) => read.text))}</p>}
      <BestPhotos state={state} thing={thing.id} />
      <div class="buttons">
        {box && <Button onClick={() => onFly(centerOf(box), boxSize(box))} text={texts.things.lookAt} />}
        {thing.name && (
          <Button
            disabled={state.busy.value}
            onClick={() => act({ action: "unname" }, texts.things.unnamedNow)}
            text={texts.things.unname}
          />
        )}
        <Button
          disabled={state.busy.value}
          onClick={() => act({ action: "discard" }, texts.things.discarded)}
          text={texts.things.discard}
        />
        <Button onClick={() => state.clearSelection()} text={texts.things.close} />
      </div>
      <p class="hint">{texts.things.mergeHelp}</p>
    </div>
  );
}
