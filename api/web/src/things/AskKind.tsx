import { useState } from "preact/hooks";

import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { wordsOf } from "./words";

interface Properties {
  state: SceneState;
  thing: number;
  name: string;
  onSkip: () => void;
}

/** Asks once what a thing is that was just given a name of which no word is known: "Oskar is a …". */
export function AskKind({ state, thing, name, onSkip }: Properties) {
  const [text, setText] = useState("");
  const kinds = wordsOf(text);
  const say = (event: Event) => {
    event.preventDefault();
    void state.edit({ action: "name", name, kinds, thing_ids: [thing] }, texts.things.saved(name));
  };
  return (
    <form onSubmit={say}>
      <label>
        {texts.things.isA(name)}
        <input
          value={text}
          autocomplete="off"
          placeholder={texts.things.kindExample}
          onInput={(event) => setText(event.currentTarget.value)}
        />
      </label>
      <Button type="submit" class="primary" disabled={state.busy.value || !kinds.length} text={texts.things.saveKind} />
      <Button onClick={onSkip} text={texts.things.skipKind} />
    </form>
  );
}
