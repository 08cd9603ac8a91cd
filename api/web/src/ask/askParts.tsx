import type { Answer, SceneObject } from "../api/types";
import { texts } from "../texts";

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
    <form
      role="search"
      onSubmit={(event) => {
        event.preventDefault();
        onAsk();
      }}
    >
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
      <button class="primary">{texts.ask.title}</button>
    </form>
  );
}

/** The sentence that the server says. */
export function Verdict({ answer }: { answer: Pick<Answer, "outcome" | "sentence"> }) {
  return <p class={`verdict ${answer.outcome}`}>{answer.sentence}</p>;
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
  return (
    <>
      <h3>{texts.ask.objects}</h3>
      <ul class="chips">
        {objects.map((object, index) => (
          <li key={object.id}>
            <button
              type="button"
              class="chip"
              aria-label={texts.ask.flyTo(object.label, index + 1)}
              onClick={() => onFly(object)}
            >
              {object.label} {index + 1}
            </button>
          </li>
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
          <li key={label}>
            <button type="button" class="chip" onClick={() => onAsk(label)}>
              {label}
            </button>
          </li>
        ))}
      </ul>
    </>
  );
}
