import { useEffect, useRef, useState } from "preact/hooks";

import { isShared } from "../address/share";
import type { SceneThing } from "../api/types";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { Check, Form } from "../ui/fields";
import { boxSize, centerOf } from "../viewer/boxes";
import type { Vec } from "../viewer/vectors";
import { filledIn, likelyNames, naming, othersSaying } from "./suggested";

interface Properties {
  state: SceneState;
  onFly: (middle: Vec, size: number) => void;
}

/** All things of the scene; those without a name can be worked through by keyboard: type, or take what is suggested, Enter, next. */
export function ThingList({ state, onFly }: Properties) {
  const [onlyUnnamed, setOnlyUnnamed] = useState(false);
  const [naming, setNaming] = useState(0); // id of the thing that is named now
  const things = state.things.value;
  if (!things) return null;
  const nameless = things.filter((thing) => !thing.name);
  const unnamed = nameless.filter((thing) => thing.kind === "thing"); // a wall needs no name to be found
  const open = (thing: SceneThing, more = false) => {
    state.select(thing.id, more);
    if (thing.box && !more) onFly(centerOf(thing.box), boxSize(thing.box));
  };
  const next = (after: number) => {
    const thing = unnamed.find((each) => each.id > after) ?? unnamed.find((each) => each.id !== after);
    setNaming(thing?.id ?? 0);
    if (thing) open(thing);
  };
  const current = unnamed.find((thing) => thing.id === naming);
  const surfaces = things.filter((thing) => thing.kind !== "thing").length;
  const shown = onlyUnnamed ? nameless : things;
  const likely = likelyNames(unnamed);
  const confirmAll = () => void state.editAll(likely, texts.things.confirmed(likely.length));
  return (
    <section class="things" aria-labelledby="things-title">
      <h2 id="things-title">{texts.things.title}</h2>
      {things.length === 0 ? (
        <p class="hint">{texts.things.none}</p>
      ) : (
        <p class="hint">
          {surfaces > 0 && texts.things.counted(things.length - surfaces, surfaces)}{" "}
          {texts.things.unnamedCount(unnamed.length, nameless.length - unnamed.length)}
        </p>
      )}
      {current && <QuickName key={current.id} state={state} thing={current} onNamed={() => next(current.id)} />}
      {unnamed.length > 0 && !isShared && (!current || likely.length > 0) && (
        <div class="buttons">
          {!current && <Button onClick={() => next(0)} text={texts.things.nameNext} />}
          {likely.length > 0 && (
            <Button disabled={state.busy.value} onClick={confirmAll} text={texts.things.confirmLikely(likely.length)} />
          )}
        </div>
      )}
      {nameless.length > 0 && (
        <Check label={texts.things.onlyUnnamed} checked={onlyUnnamed} onChange={setOnlyUnnamed} />
      )}
      <ul class="thing-list">
        {shown.map((thing) => (
          <li key={thing.id}>
            <input
              type="checkbox"
              aria-label={texts.things.tick(texts.things.titleOf(thing))}
              checked={state.selected.value.includes(thing.id)}
              onChange={() => open(thing, true)}
            />
            <Button
              class="plain"
              aria-pressed={state.selected.value.includes(thing.id)}
              onClick={() => open(thing)}
              onPointerEnter={() => (state.hovered.value = thing.id)}
              onPointerLeave={() => (state.hovered.value = 0)}
              text={texts.things.titleOf(thing)}
            />
          </li>
        ))}
      </ul>
    </section>
  );
}

function QuickName({ state, thing, onNamed }: { state: SceneState; thing: SceneThing; onNamed: () => void }) {
  const field = useRef<HTMLInputElement>(null);
  const offered = filledIn(thing);
  useEffect(() => {
    field.current?.focus();
    field.current?.select(); // typing replaces what is filled in
  }, []);
  return (
    <Form
      onSubmit={() => {
        const name = field.current?.value.trim();
        if (!name) onNamed();
        else void state.edit(naming(thing, name), texts.things.saved(name)).then((done) => done && onNamed());
      }}
    >
      <label>
        {texts.things.unnamed(thing.id)}
        <input
          ref={field}
          autocomplete="off"
          list="suggested-names"
          defaultValue={offered?.name ?? ""}
          aria-describedby={offered ? "who-says" : undefined}
        />
      </label>
      {offered && (
        <p class="hint" id="who-says">
          {texts.things.suggested(offered.name, offered.probability, othersSaying(offered))}
        </p>
      )}
      <datalist id="suggested-names">
        {thing.suggestions.map((suggestion) => (
          <option key={suggestion.name} value={suggestion.name} />
        ))}
      </datalist>
      <Button type="submit" class="primary" disabled={state.busy.value} text={texts.things.nameNext} />
    </Form>
  );
}
