import { useEffect, useRef, useState } from "preact/hooks";

import { isShared } from "../address/share";
import type { SceneObject } from "../api/types";
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

/** All objects of the scene; those without a name can be worked through by keyboard: type, or take what is suggested, Enter, next. */
export function ObjectList({ state, onFly }: Properties) {
  const [onlyUnnamed, setOnlyUnnamed] = useState(false);
  const [naming, setNaming] = useState(0); // id of the object that is named now
  const objects = state.objects.value;
  if (!objects) return null;
  const nameless = objects.filter((object) => !object.name);
  const unnamed = nameless.filter((object) => object.kind === "object"); // a wall needs no name to be found
  const open = (object: SceneObject, more = false) => {
    state.select(object.id, more);
    if (object.box && !more) onFly(centerOf(object.box), boxSize(object.box));
  };
  const next = (after: number) => {
    const object = unnamed.find((each) => each.id > after) ?? unnamed.find((each) => each.id !== after);
    setNaming(object?.id ?? 0);
    if (object) open(object);
  };
  const current = unnamed.find((object) => object.id === naming);
  const surfaces = objects.filter((object) => object.kind !== "object").length;
  const shown = onlyUnnamed ? nameless : objects;
  const likely = likelyNames(unnamed);
  const confirmAll = () => void state.editAll(likely, texts.objects.confirmed(likely.length));
  return (
    <section class="objects" aria-labelledby="objects-title">
      <h2 id="objects-title">{texts.objects.title}</h2>
      {objects.length === 0 ? (
        <p class="hint">{texts.objects.none}</p>
      ) : (
        <p class="hint">
          {surfaces > 0 && texts.objects.counted(objects.length - surfaces, surfaces)}{" "}
          {texts.objects.unnamedCount(unnamed.length, nameless.length - unnamed.length)}
        </p>
      )}
      {current && <QuickName key={current.id} state={state} object={current} onNamed={() => next(current.id)} />}
      {unnamed.length > 0 && !isShared && (!current || likely.length > 0) && (
        <div class="buttons">
          {!current && <Button onClick={() => next(0)} text={texts.objects.nameNext} />}
          {likely.length > 0 && (
            <Button
              disabled={state.busy.value}
              onClick={confirmAll}
              text={texts.objects.confirmLikely(likely.length)}
            />
          )}
        </div>
      )}
      {nameless.length > 0 && (
        <Check label={texts.objects.onlyUnnamed} checked={onlyUnnamed} onChange={setOnlyUnnamed} />
      )}
      <ul class="object-list">
        {shown.map((object) => (
          <li key={object.id}>
            <input
              type="checkbox"
              aria-label={texts.objects.tick(texts.objects.titleOf(object))}
              checked={state.selected.value.includes(object.id)}
              onChange={() => open(object, true)}
            />
            <Button
              class="plain"
              aria-pressed={state.selected.value.includes(object.id)}
              onClick={() => open(object)}
              onPointerEnter={() => (state.hovered.value = object.id)}
              onPointerLeave={() => (state.hovered.value = 0)}
              text={texts.objects.titleOf(object)}
            />
          </li>
        ))}
      </ul>
    </section>
  );
}

function QuickName({ state, object, onNamed }: { state: SceneState; object: SceneObject; onNamed: () => void }) {
  const field = useRef<HTMLInputElement>(null);
  const offered = filledIn(object);
  useEffect(() => {
    field.current?.focus();
    field.current?.select(); // typing replaces what is filled in
  }, []);
  return (
    <Form
      onSubmit={() => {
        const name = field.current?.value.trim();
        if (!name) onNamed();
        else void state.edit(naming(object, name), texts.objects.saved(name)).then((done) => done && onNamed());
      }}
    >
      <label>
        {texts.objects.unnamed(object.id)}
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
          {texts.objects.suggested(offered.name, offered.probability, othersSaying(offered))}
        </p>
      )}
      <datalist id="suggested-names">
        {object.suggestions.map((suggestion) => (
          <option key={suggestion.name} value={suggestion.name} />
        ))}
      </datalist>
      <Button type="submit" class="primary" disabled={state.busy.value} text={texts.objects.nameNext} />
    </Form>
  );
}
