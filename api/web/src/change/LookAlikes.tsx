import { computed, signal, useSignalEffect } from "@preact/signals";
import { useEffect, useMemo } from "preact/hooks";

import type { SceneObject } from "../api/types";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { Button } from "../ui/Button";
import { boxSize, centerOf } from "../viewer/boxes";
import type { Vec } from "../viewer/vectors";
import { lookAlikes } from "./lookAlikeList";
import { typing } from "./shortcuts";

interface Properties {
  state: SceneState;
  onFly: (middle: Vec, size: number) => void;
}

/** After an object was named: those that look like it, one by one, each settled by one key. */
export function LookAlikes({ state, onFly }: Properties) {
  const round = useMemo(() => new Round(state), [state]);
  useSignalEffect(() => round.notice());
  const name = round.name.value;
  const [next, ...others] = round.open.value;
  useEffect(() => {
    if (!next) return;
    state.hovered.value = next.id; // lights it up
    const ended = new AbortController();
    document.addEventListener(
      "keydown",
      (event) => {
        if (event.ctrlKey || event.metaKey || event.altKey || typing(event)) return;
        const key = event.key.toLowerCase();
        if (key === "n") round.decline(next);
        else if (key === "y" && !state.busy.value) round.confirm([next]);
        else return;
        event.preventDefault();
      },
      { signal: ended.signal },
    );
    return () => {
      ended.abort();
      state.hovered.value = 0;
    };
  }, [next, state, round]);
  if (!next) return null;
  const probability = next.suggestions.find((each) => each.name === name)?.probability ?? 0;
  const { box } = next;
  return (
    <section class="note look-alikes" aria-label={texts.change.lookAlikes(name)}>
      <p role="status">{texts.change.lookAlike(texts.objects.titleOf(next), name, probability)}</p>
      <div class="buttons">
        <Button
          class="primary"
          disabled={state.busy.value}
          onClick={() => round.confirm([next])}
          text={texts.change.lookAlikeYes}
        />
        <Button onClick={() => round.decline(next)} text={texts.change.lookAlikeNo} />
        {others.length > 0 && (
          <Button
            disabled={state.busy.value}
            onClick={() => round.confirm([next, ...others])}
            text={texts.change.lookAlikeAll(others.length + 1)}
          />
        )}
        {box && <Button onClick={() => onFly(centerOf(box), boxSize(box))} text={texts.objects.lookAt} />}
      </div>
    </section>
  );
}

/** One name that was given, and what has not been said of the objects that look like it. */
class Round {
  readonly name = signal("");
  readonly #declined = signal<ReadonlySet<number>>(new Set());
  readonly open = computed(() => lookAlikes(this.state.objects.value ?? [], this.name.value, this.#declined.value));

  constructor(private readonly state: SceneState) {}

  /** Begins anew with another name, and ends when its version is left. */
  notice(): void {
    const made = this.state.made.value;
    const edit = made?.edits.at(-1);
    const name = edit?.action === "name" ? (edit.name ?? "") : "";
    if (name === this.name.peek()) return;
    this.name.value = name;
    this.#declined.value = new Set();
  }

  confirm(objects: SceneObject[]): void {
    const name = this.name.value;
    void this.state.edit(
      { action: "name", object_ids: objects.map((object) => object.id), name },
      texts.objects.saved(name),
    );
  }

  decline(object: SceneObject): void {
    this.#declined.value = new Set([...this.#declined.value, object.id]);
  }
}
