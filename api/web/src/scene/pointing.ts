import { ApiError, isAbort } from "../api/http";
import type { SeenPlace } from "../state/changeState";
import type { SceneState } from "../state/sceneState";
import { texts } from "../texts";
import type { LookAt } from "../viewer/poses";
import { cameraOf } from "../viewer/poses";

const REST_MS = 90; // a moving pointer asks nothing
const CLICK_PIXELS = 4;
const LONGEST_SIDE = 640; // of the picture that the server picks in

/** Asks the server which thing is under the pointer: hovering lights it up, a click selects it. */
export class Pointing {
  readonly #ended = new AbortController();
  #hover = new AbortController();
  #timer = 0;
  #pressed: { x: number; y: number } | null = null;

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
    if (event.buttons || event.pointerType === "touch") return;
    this.#timer = window.setTimeout(() => {
      this.#hover = new AbortController();
      const { signal } = this.#hover;
      this.#thingAt(event, signal).then(
        (id) => {
          if (!signal.aborted) this.state.hovered.value = id;
        },
        () => undefined, // a click says what is wrong
      );
    }, REST_MS);
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
    const { onPlace } = this.state.change;
    if (onPlace.value) {
      onPlace.value(this.#place(event));
      return;
    }
    const more = event.shiftKey;
    this.#thingAt(event, this.#ended.signal).then(
      (id) => {
        if (id) this.state.select(id, more);
        else if (!more) this.state.clearSelection();
        this.state.message.value = id ? "" : texts.things.nothingThere;
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

  /** Id of the thing there; 0 for none. */
  async #thingAt(event: PointerEvent, signal: AbortSignal): Promise<number> {
    const { camera, pixel } = this.#place(event);
    try {
      const { id } = (await this.state.pick(camera, pixel, signal)).thing;
      return this.state.change.shows(id) ? id : 0;
    } catch (error) {
      if (error instanceof ApiError && error.status === 404) return 0;
      throw error;
    }
  }
}
