import type { ComponentChildren } from "preact";

import { isShared } from "../address/share";
import type { Answer } from "../api/types";
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
  const ids = answer.things;
  const here = answer.outcome === "here" || answer.outcome === "probably_here";
  const meant = (state.things.value ?? []).filter((thing) => ids.includes(thing.id));
  const unnamed = meant.filter((thing) => !thing.name);
  const label = answer.matches.find((match) => match.relevant)?.label ?? "";
  if (here)
    return (
      <>
        <BestPhotos state={state} text={answer.text} />
        <ul class="chips follow-ups">
          {meant.length > 0 && <Chip onClick={() => select(state, ids)}>{texts.ask.select}</Chip>}
          {label && <Chip onClick={() => onAsk(texts.ask.near(label))}>{texts.ask.near(label)}</Chip>}
          {answer.outcome === "probably_here" && unnamed.length > 0 && label && !isShared && (
            <Chip
              onClick={() =>
                void state.edit(
                  { action: "name", things: unnamed.map((thing) => thing.id), name: label },
                  texts.things.saved(label),
                )
              }
            >
              {texts.ask.confirm(label)}
            </Chip>
          )}
        </ul>
      </>
    );
  return (
    <>
      {meant.length > 0 && (
        <ul class="chips">
          {meant.slice(0, MOST_SHOWN).map((thing) => (
            <Chip
              key={thing.id}
              label={texts.ask.lookAt(texts.things.titleOf(thing))}
              before={!thing.name && <ThingPicture state={state} thing={thing.id} />}
              onClick={() => onThing(thing.id)}
            >
              {thing.name || thing.id}
            </Chip>
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

const MOST_SHOWN = 6;

function select(state: SceneState, ids: readonly number[]): void {
  state.selected.value = ids;
  state.tab.value = "things";
}
