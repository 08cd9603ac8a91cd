import { ApiError, isAbort } from "../api/http";
import type { PickedObject, PickIn, PickLevel } from "../api/types";
import type { SeenPlace } from "../state/changeState";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import type { LookAt } from "../viewer/poses";
import { cameraOf } from "../viewer/poses";
import { nextLevel } from "./levels";

type Asked = Partial<Pick<PickIn, "level" | "mask3d">>;
type AskedLevel = PickIn["level"];

const REST_MS = 90; // a moving pointer asks nothing
const CLICK_PIXELS = 4;
const LONGEST_SIDE = 640; // of the picture that the server picks in

/** Asks the server which object is under the pointer: hovering lights it up, a click selects it, a second one a part. */
export class Pointing {
  readonly #ended = new AbortController();
  #hover = new AbortController();
  #timer = 0;
  #brushing = false;
  #pressed: { x: number; y: number } | null = null;
  /** Where the last click was, what it picked, and what was selected by that. */
  #last: { place: SeenPlace; picked: PickedObject; selected: readonly number[] } | null = null;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly state: SceneState,
    private readonly view: () => LookAt,
  ) {
    const options = { signal: this.#ended.signal };
    canvas.addEventListener("pointermove", (event) => this.#moved(event), options);
    canvas.addEventListener("pointerleave", () => this.#leave(), options);
    canvas.addEventListener(
      "pointerdown",
      (event) => {
        this.#leave();
        this.#pressed = event.button === 0 && event.isPrimary ? { x: event.clientX, y: event.clientY } : null;
      },
      options,
    );
    canvas.addEventListener("pointerup", (event) => this.#released(event), options);
  }

  destroy(): void {
    this.#ended.abort();
    this.#leave();
  }

  #moved(event: PointerEvent): void {
    window.clearTimeout(this.#timer);
    this.#hover.abort();
    if (event.buttons === 1 && this.state.change.brush.value !== null) this.#brush(event);
    if (event.buttons || event.pointerType === "touch") return;
    this.#timer = window.setTimeout(() => {
      this.#hover = new AbortController();
      const { signal } = this.#hover;
      this.#pickedAt(this.#place(event), signal).then(
        (picked) => {
          if (!signal.aborted) this.state.hovered.value = picked?.object.id ?? 0;
        },
        () => undefined, // a click says what is wrong
      );
    }, REST_MS);
  }

  /** Marks the object under the pointer; while the server looks for one, the pointer passes others. */
  #brush(event: PointerEvent): void {
    const { brush } = this.state.change;
    if (this.#brushing) return;
    this.#brushing = true;
    this.#pickedAt(this.#place(event), this.#ended.signal)
      .then(
        (picked) => {
          if (picked && brush.value) brush.value = [...new Set([...brush.value, picked.object.id])];
        },
        (error: unknown) => {
          if (!isAbort(error)) this.state.actionError.value = error;
        },
      )
      .finally(() => (this.#brushing = false));
  }

  #leave(): void {
    window.clearTimeout(this.#timer);
    this.#hover.abort();
    this.state.hovered.value = 0;
  }

  #released(event: PointerEvent): void {
    const pressed = this.#pressed;
    this.#pressed = null;
    if (!pressed || Math.hypot(event.clientX - pressed.x, event.clientY - pressed.y) > CLICK_PIXELS) return;
    const { brush, onPlace } = this.state.change;
    if (brush.value !== null) {
      this.#brush(event);
      return;
    }
    if (onPlace.value) {
      onPlace.value(this.#place(event));
      return;
    }
    const more = event.shiftKey;
    const place = this.#place(event);
    const level = more ? "object" : this.#levelAt(place);
    this.#pickedAt(place, this.#ended.signal, { level, mask3d: !more }).then(
      (picked) => {
        if (picked && more) this.state.select(picked.object.id, true);
        else if (picked) this.state.selectPicked(picked);
        else if (!more) this.state.clearSelection();
        this.#last = picked && !more ? { place, picked, selected: this.state.selected.value } : null;
        if (!picked) this.state.message.value = texts.objects.nothingThere;
        else this.state.message.value = this.#last ? this.#levelText(picked) : "";
      },
      (error: unknown) => {
        if (!isAbort(error)) this.state.actionError.value = error;
      },
    );
  }

  /** Where an event is in the picture. */
  #place(event: PointerEvent): SeenPlace {
    const { width, height, left, top } = this.canvas.getBoundingClientRect();
    const ratio = Math.min(1, LONGEST_SIDE / Math.max(width, height));
    const [w, h] = [Math.max(1, Math.round(width * ratio)), Math.max(1, Math.round(height * ratio))];
    const pixel = {
      x: Math.min(w - 0.5, Math.max(0, ((event.clientX - left) * w) / width)),
      y: Math.min(h - 0.5, Math.max(0, ((event.clientY - top) * h) / height)),
    };
    return { camera: cameraOf(this.view(), w, h), pixel };
  }

  /** What a click there asks for: once more on the same place, the level after the one that it selected. */
  #levelAt({ camera, pixel }: SeenPlace): AskedLevel {
    const last = this.#last;
    if (!last || last.selected !== this.state.selected.value) return "likeliest";
    const near = Math.hypot(pixel.x - last.place.pixel.x, pixel.y - last.place.pixel.y) <= CLICK_PIXELS;
    const still = JSON.stringify(camera) === JSON.stringify(last.place.camera);
    return near && still ? nextLevel(last.picked) : "likeliest";
  }

  /** Says which level is selected, where there are several. */
  #levelText(picked: PickedObject): string {
    if (picked.levels.length < 2) return "";
    const members = picked.levels.find((each) => each.level === "group")?.members.length ?? 0;
    const word = (level: PickLevel) => texts.objects.level(level, picked.object, picked.part ?? null, members);
    return texts.objects.clickAgain(word(picked.level), word(nextLevel(picked)));
  }

  /** What is there and shown; null for nothing. */
  async #pickedAt(place: SeenPlace, signal: AbortSignal, more?: Asked): Promise<PickedObject | null> {
    try {
      const picked = await this.state.pick(place, signal, more);
      return this.state.change.shows(picked.object.id) ? picked : null;
    } catch (error) {
      if (error instanceof ApiError && error.status === 404) return null;
      throw error;
    }
  }
}
