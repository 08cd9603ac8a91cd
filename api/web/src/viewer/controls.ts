import type { CameraMotion } from "./cameraMotion";
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
        this.motion.set(zoom(this.motion.view, Math.exp(event.deltaY * WHEEL)));
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
      this.motion.set(
        moves ? fly(view, -dx * perPixel, dy * perPixel, 0) : orbit(view, -dx * RADIANS_A_PIXEL, dy * RADIANS_A_PIXEL),
      );
    } else {
      const [other] = [...this.#pointers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
      if (other) {
        const spread = (place: { x: number; y: number }) => Math.hypot(place.x - other.x, place.y - other.y);
        const zoomed = zoom(view, spread(before) / Math.max(spread(now), 1));
        this.motion.set(fly(zoomed, (-dx / 2) * perPixel, (dy / 2) * perPixel, 0));
      }
    }
    this.#pointers.set(event.pointerId, now);
  }

  #key(event: KeyboardEvent): void {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const { view } = this.motion;
    const rotate = event.shiftKey ? turn : orbit;
    const sign = event.shiftKey ? -1 : 1;
    const moves: Record<string, () => void> = {
      ArrowLeft: () => this.motion.set(rotate(view, -KEY_RADIANS * sign, 0)),
      ArrowRight: () => this.motion.set(rotate(view, KEY_RADIANS * sign, 0)),
      ArrowUp: () => this.motion.set(rotate(view, 0, KEY_RADIANS)),
      ArrowDown: () => this.motion.set(rotate(view, 0, -KEY_RADIANS)),
      w: () => this.motion.set(fly(view, 0, 0, KEY_SHARE)),
      s: () => this.motion.set(fly(view, 0, 0, -KEY_SHARE)),
      a: () => this.motion.set(fly(view, -KEY_SHARE, 0, 0)),
      d: () => this.motion.set(fly(view, KEY_SHARE, 0, 0)),
      e: () => this.motion.set(fly(view, 0, KEY_SHARE, 0)),
      q: () => this.motion.set(fly(view, 0, -KEY_SHARE, 0)),
      "+": () => this.motion.set(zoom(view, 1 - KEY_SHARE)),
      "=": () => this.motion.set(zoom(view, 1 - KEY_SHARE)),
      "-": () => this.motion.set(zoom(view, 1 + KEY_SHARE)),
      Home: this.goHome,
    };
    const move = moves[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!move) return;
    event.preventDefault();
    move();
  }
}
