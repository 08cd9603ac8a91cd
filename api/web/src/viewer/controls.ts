import type { Gesture } from "./cameraBound";
import type { CameraMotion } from "./cameraMotion";
import type { LookAt } from "./poses";
import { fly, orbit, turn, zoom } from "./poses";

const RADIANS_A_PIXEL = 0.006;
const KEY_RADIANS = 0.08;
const KEY_SHARE = 0.06;
const WHEEL = 0.0015;

/** Mouse, touch and keyboard on the canvas. */
export class Controls {
  readonly #pointers = new Map<number, { x: number; y: number }>();
  readonly #ended = new AbortController();

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly motion: CameraMotion,
    private readonly goHome: () => void,
    private readonly bounded: (gesture: Gesture) => LookAt = (gesture) => gesture(1),
  ) {
    const options = { signal: this.#ended.signal };
    canvas.addEventListener("pointerdown", (event) => this.#down(event), options);
    canvas.addEventListener("pointermove", (event) => this.#move(event), options);
    for (const name of ["pointerup", "pointercancel"] as const)
      canvas.addEventListener(name, (event) => this.#pointers.delete(event.pointerId), options);
    canvas.addEventListener("contextmenu", (event) => event.preventDefault(), options);
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        const { view } = this.motion;
        this.#go((share) => zoom(view, Math.exp(share * event.deltaY * WHEEL)));
      },
      { ...options, passive: false },
    );
    canvas.addEventListener("keydown", (event) => this.#key(event), options);
  }

  destroy(): void {
    this.#ended.abort();
  }

  #down(event: PointerEvent): void {
    this.#pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    this.canvas.setPointerCapture(event.pointerId);
  }

  #move(event: PointerEvent): void {
    const before = this.#pointers.get(event.pointerId);
    if (!before) return;
    const now = { x: event.clientX, y: event.clientY };
    const [dx, dy] = [now.x - before.x, now.y - before.y];
    const { view } = this.motion;
    const perPixel = 1 / this.canvas.clientHeight;
    if (this.#pointers.size === 1) {
      const moves = event.buttons === 2 || event.buttons === 4;
      this.#go((share) =>
        moves
          ? fly(view, -dx * perPixel * share, dy * perPixel * share, 0)
          : orbit(view, -dx * RADIANS_A_PIXEL * share, dy * RADIANS_A_PIXEL * share),
      );
    } else {
      const [other] = [...this.#pointers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
      if (other) {
        const spread = (place: { x: number; y: number }) => Math.hypot(place.x - other.x, place.y - other.y);
        const ratio = spread(before) / Math.max(spread(now), 1);
        this.#go((share) =>
          fly(zoom(view, ratio ** share), (-dx / 2) * perPixel * share, (dy / 2) * perPixel * share, 0),
        );
      }
    }
    this.#pointers.set(event.pointerId, now);
  }

  #key(event: KeyboardEvent): void {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const { view } = this.motion;
    const rotate = event.shiftKey ? turn : orbit;
    const sign = event.shiftKey ? -1 : 1;
    const moves: Record<string, Gesture> = {
      ArrowLeft: (share) => rotate(view, -KEY_RADIANS * sign * share, 0),
      ArrowRight: (share) => rotate(view, KEY_RADIANS * sign * share, 0),
      ArrowUp: (share) => rotate(view, 0, KEY_RADIANS * share),
      ArrowDown: (share) => rotate(view, 0, -KEY_RADIANS * share),
      w: (share) => fly(view, 0, 0, KEY_SHARE * share),
      s: (share) => fly(view, 0, 0, -KEY_SHARE * share),
      a: (share) => fly(view, -KEY_SHARE * share, 0, 0),
      d: (share) => fly(view, KEY_SHARE * share, 0, 0),
      e: (share) => fly(view, 0, KEY_SHARE * share, 0),
      q: (share) => fly(view, 0, -KEY_SHARE * share, 0),
      "+": (share) => zoom(view, 1 - KEY_SHARE * share),
      "=": (share) => zoom(view, 1 - KEY_SHARE * share),
      "-": (share) => zoom(view, 1 + KEY_SHARE * share),
    };
    const move = moves[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!move && event.key !== "Home") return;
    event.preventDefault();
    if (move) this.#go(move);
    else this.goHome();
  }

  #go(gesture: Gesture): void {
    this.motion.set(this.bounded(gesture));
  }
}
