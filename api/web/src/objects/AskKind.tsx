import { useState } from "preact/hooks";

import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { wordsOf } from "./words";

interface Properties {
  state: SceneState;
  object: number;
  name: string;
  onSkip: () => void;
}

/** Asks once what an object is that was just given a name of which no word is known: "Oskar is a …". */
export function AskKind({ state, object, name, onSkip }: Properties) {
  const [text, setText] = useState("");
  const kinds = wordsOf(text);
  const say = (event: Event) => {
    event.preventDefault();
    void state.edit({ action: "name", name, kinds, object_ids: [object] }, texts.objects.saved(name));
  };
  return (
    <form onSubmit={say}>
      <label>
        {texts.objects.isA(name)}
        <input
          value={text}
          autocomplete="off"
          placeholder={texts.objects.kindExample}
          onInput={(event) => setText(event.currentTarget.value)}
        />
      </label>
      <Button
        type="submit"
        class="primary"
        disabled={state.busy.value || !kinds.length}
        text={texts.objects.saveKind}
      />
      <Button onClick={onSkip} text={texts.objects.skipKind} />
    </form>
  );
}
