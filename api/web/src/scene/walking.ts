import { endPrompt } from "../change/prompts";
import { endRuler } from "../change/ruler";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import { centerOf } from "../viewer/boxes";
import type { Point } from "../viewer/projection";
import { Projection } from "../viewer/projection";
import type { Direction } from "../viewer/walk";
import { nearestTo, nextIn } from "../viewer/walk";

/** From object to object by keyboard in the picture on show: Enter begins and selects, arrows walk, Escape leaves. */
export class Walking {
  readonly #ended = new AbortController();
  #at: number | null = null; // id of the object that is lit up; null while nobody walks

  constructor(
    canvas: HTMLCanvasElement,
    private readonly state: SceneState,
  ) {
    const options = { signal: this.#ended.signal };
    canvas.addEventListener("keydown", (event) => this.#key(event), options);
    canvas.addEventListener("blur", () => this.#stand(null), options);
    canvas.addEventListener("pointerdown", () => this.#stand(null), options);
  }

  destroy(): void {
    this.#ended.abort();
  }

  #key(event: KeyboardEvent): void {
    if (event.ctrlKey || event.altKey || event.metaKey || event.shiftKey) return;
    if (event.key === "Enter") this.#enter();
    else if (event.key === "Escape") this.#leave();
    else if (this.#at !== null && event.key.startsWith("Arrow")) {
      const next = nextIn(event.key as Direction, this.#at, this.#places());
      if (next !== null) this.#stand(next);
    } else return;
    event.preventDefault();
    event.stopImmediatePropagation(); // arrows turn the view while nobody walks
  }

  #enter(): void {
    const { onPlace } = this.state.change;
    const place = this.state.change.middle();
    if (onPlace.value && place)
      onPlace.value(place); // a tool takes what the crosshair is on
    else if (this.#at === null) this.#begin();
    else this.state.select(this.#at);
  }

  #leave(): void {
    const { ruler, prompt } = this.state.change;
    if (this.#at !== null) this.#stand(null);
    else if (ruler.value) endRuler(this.state);
    else if (prompt.value) endPrompt(this.state);
    else this.state.clearSelection();
  }

  #begin(): void {
    const { width, height } = this.state.change.size.peek();
    this.#stand(nearestTo([width / 2, height / 2], this.#places()));
    if (this.#at !== null) this.state.message.value = `${this.state.message.peek()} ${texts.scene.walkBegins}`;
  }

  #stand(at: number | null): void {
    if (at === null && this.#at === null) return;
    this.#at = at;
    this.state.hovered.value = at ?? 0;
    const object = this.state.objects.peek()?.find((each) => each.id === at);
    this.state.message.value = object ? texts.objects.titleOf(object) : "";
  }

  /** Where the middles of the objects on show are in the picture. */
  #places(): ReadonlyMap<number, Point> {
    const { change, objects } = this.state;
    const [view, size] = [change.view.peek(), change.size.peek()];
    const places = new Map<number, Point>();
    if (!view || !size.width) return places;
    const projection = new Projection(view, size);
    for (const object of objects.peek() ?? []) {
      const point = object.box && change.shows(object.id) ? projection.point(centerOf(object.box)) : null;
      const inside = point && point[0] >= 0 && point[1] >= 0 && point[0] < size.width && point[1] < size.height;
      if (inside) places.set(object.id, point);
    }
    return places;
  }
}
