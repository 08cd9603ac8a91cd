import { type ComponentChildren, Fragment } from "preact";

import { isShared } from "../address/share";
import type { Answer, SceneThing } from "../api/types";
import { BestPhotos } from "../look/BestPhotos";
import { ThingPicture } from "../look/ThingPicture";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { Chip } from "../ui/Chip";

interface Properties {
  state: SceneState;
  answer: Answer;
  onAsk: (text: string) => void;
  onThing: (id: number) => void;
  /** What can be done about something that is not here. */
  lookAgain: (text: string) => ComponentChildren;
}

/** What can be asked or done next, by what the answer is. */
export function FollowUps({ state, answer, onAsk, onThing, lookAgain }: Properties) {
  const ids = answer.thing_ids;
  const here = answer.outcome === "here" || answer.outcome === "probably_here";
  const meant = ids.flatMap((id) => state.things.value?.find((thing) => thing.id === id) ?? []);
  const unnamed = meant.filter((thing) => !thing.name);
  const label = answer.matches.find((match) => match.relevant)?.label ?? "";
  const confirm = (things: readonly SceneThing[], name: string) => {
    const ids = things.map((thing) => thing.id);
    const edit = () => void state.edit({ action: "name", thing_ids: ids, name }, texts.things.saved(name));
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
        <ul class="chips">
          {meant.slice(0, MOST_SHOWN).map((thing) => (
            <Fragment key={thing.id}>
              <Chip
                label={texts.ask.lookAt(texts.things.titleOf(thing))}
                before={!thing.name && <ThingPicture state={state} thing={thing.id} />}
                onClick={() => onThing(thing.id)}
              >
                {thing.name || thing.id}
              </Chip>
              {!thing.name && !answer.phrase?.refusal && confirm([thing], answer.asked)}
            </Fragment>
          ))}
        </ul>
      )}
      {(answer.outcome === "not_here" || answer.outcome === "not_seen") && lookAgain(answer.text)}
      <ul class="chips follow-ups">
        <Chip onClick={() => (state.tab.value = "things")}>{texts.ask.seeThings}</Chip>
      </ul>
    </>
  );
}

const MOST_SHOWN = 8;

function select(state: SceneState, ids: readonly number[]): void {
  state.selected.value = ids;
  state.tab.value = "things";
}
