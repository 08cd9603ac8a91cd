import type { ComponentChildren } from "preact";

import { isShared } from "../address/share";
import type { Answer, SceneObject } from "../api/types";
import { BestPhotos } from "../look/BestPhotos";
import { ObjectPicture } from "../look/ObjectPicture";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { Chip } from "../ui/Chip";

interface Properties {
  state: SceneState;
  answer: Answer;
  onAsk: (text: string) => void;
  onObject: (id: number) => void;
  /** What can be done about something that is not here. */
  lookAgain: (text: string) => ComponentChildren;
}

/** What can be asked or done next, by what the answer is. */
export function FollowUps({ state, answer, onAsk, onObject, lookAgain }: Properties) {
  const ids = answer.object_ids;
  const here = answer.outcome === "here" || answer.outcome === "probably_here";
  const meant = ids.flatMap((id) => state.objects.value?.find((object) => object.id === id) ?? []);
  const unnamed = meant.filter((object) => !object.name);
  const label = answer.matches.find((match) => match.relevant)?.label ?? "";
  const confirm = (objects: readonly SceneObject[], name: string) => {
    const ids = objects.map((object) => object.id);
    const edit = () => void state.edit({ action: "name", object_ids: ids, name }, texts.objects.saved(name));
    return !isShared && <Chip onClick={edit}>{texts.ask.confirm(name)}</Chip>;
  };
  if (here)
    return (
      <>
        <BestPhotos state={state} text={answer.text} />
        <ul class="chips follow-ups">
          {meant.length > 0 && <Chip onClick={() => select(state, ids)}>{texts.ask.select}</Chip>}
          {label && <Chip onClick={() => onAsk(texts.ask.near(label))}>{texts.ask.near(label)}</Chip>}
          {answer.outcome === "probably_here" && unnamed.length > 0 && label && confirm(unnamed, label)}
        </ul>
      </>
    );
  return (
    <>
      {meant.length > 0 && (
        <div class="chips">
          {meant.slice(0, MOST_SHOWN).map((object) => (
            <ul key={object.id} class="chips candidate">
              <Chip
                label={texts.ask.lookAt(texts.objects.titleOf(object))}
                before={!object.name && <ObjectPicture state={state} object={object.id} />}
                onClick={() => onObject(object.id)}
              >
                {object.name || texts.objects.numbered(object.id, object.surface)}
              </Chip>
              {!object.name && !answer.phrase?.refusal && confirm([object], answer.noun_phrase)}
            </ul>
          ))}
        </div>
      )}
      {(answer.outcome === "not_here" || answer.outcome === "not_seen") && lookAgain(answer.text)}
      <ul class="chips follow-ups">
        <Chip onClick={() => (state.tab.value = "objects")}>{texts.ask.seeObjects}</Chip>
      </ul>
    </>
  );
}

const MOST_SHOWN = 8;

function select(state: SceneState, ids: readonly number[]): void {
  state.selected.value = ids;
  state.tab.value = "objects";
}
