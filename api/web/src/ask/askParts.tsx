import type { Answer, SceneObject } from "../api/types";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { Chip } from "../ui/Chip";
import { Form } from "../ui/fields";
import type { IconName } from "../ui/Icon";
import { Icon } from "../ui/Icon";
import { spoken } from "./spoken";

/** The parts of a question that a page with a server and a file without one share. */

export function QuestionForm({
  text,
  placeholder = "",
  onType,
  onAsk,
}: {
  text: string;
  placeholder?: string;
  onType: (text: string) => void;
  onAsk: () => void;
}) {
  return (
    <Form role="search" onSubmit={() => onAsk()}>
      <label class="sr-only" for="question">
        {texts.ask.label}
      </label>
      <input
        id="question"
        type="search"
        value={text}
        maxLength={1000}
        placeholder={placeholder}
        autocomplete="off"
        onInput={(event) => onType(event.currentTarget.value)}
      />
      <Button type="submit" class="primary" text={texts.ask.title} />
    </Form>
  );
}

const ICONS: Record<Answer["outcome"], IconName> = {
  here: "here",
  probably_here: "maybe",
  not_here: "absent",
  not_seen: "unseen",
  cannot_say: "help",
};

/** The sentence that the server says: its first word large, its figure beside it. */
export function Verdict({ answer }: { answer: Pick<Answer, "outcome" | "sentence"> }) {
  const { word, figure, rest } = spoken(answer.sentence);
  return (
    <p class={`verdict ${answer.outcome}`}>
      {word && (
        <>
          <Icon name={ICONS[answer.outcome]} />
          <strong class="verdict-word">{word}</strong>
          {figure && (
            <span class="verdict-figure">
              <span class="sr-only"> (</span>
              {figure}
              <span class="sr-only">)</span>
            </span>
          )}
          <span class="sr-only">{rest ? ": " : "."}</span>
        </>
      )}
      {rest && <span class="verdict-text">{rest}</span>}
    </p>
  );
}

/** The objects of an answer, to fly to. */
export function ObjectChips({
  objects,
  onFly,
}: {
  objects: readonly SceneObject[];
  onFly: (object: SceneObject) => void;
}) {
  if (objects.length === 0) return null;
  const numbered = objects.map((object, index) => {
    const alike = objects.filter(({ name }) => name === object.name);
    const before = objects.slice(0, index).filter(({ name }) => name === object.name);
    return { object, number: before.length + 1, alone: alike.length === 1 };
  });
  return (
    <>
      <h3>{texts.ask.objects}</h3>
      <ul class="chips">
        {numbered.map(({ object, number, alone }) => (
          <Chip
            key={object.id}
            label={texts.ask.flyTo(object.name, number)}
            behind={!alone && number}
            onClick={() => onFly(object)}
          >
            {object.name}
          </Chip>
        ))}
      </ul>
    </>
  );
}

/** The labels that a scene knows, to ask for. */
export function KnownLabels({ labels, onAsk }: { labels: readonly string[]; onAsk: (label: string) => void }) {
  return (
    <>
      <h3>{texts.ask.knownLabels}</h3>
      <ul class="chips">
        {labels.map((label) => (
          <Chip key={label} onClick={() => onAsk(label)}>
            {label}
          </Chip>
        ))}
      </ul>
    </>
  );
}
