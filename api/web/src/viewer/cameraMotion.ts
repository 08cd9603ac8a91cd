import type { LookAt } from "./poses";
import { between, orbit } from "./poses";

const FLIGHT_MS = 700;
const SWAY_MS = 9_000;
const REST_MS = 250;

const wantsNoMotion = (): boolean => matchMedia("(prefers-reduced-motion: reduce)").matches;

/** Where the camera is, and its flights. A person who wants no motion gets there at once. */
export class CameraMotion {
  #view: LookAt;
  #frame = 0;
  #timer = 0;
  #drawn = 0;

  /** @param changed called with the view, and whether it has come to rest. */
  constructor(
    view: LookAt,
    private readonly changed: (view: LookAt, resting: boolean) => void,
  ) {
    this.#view = view;
  }

  get view(): LookAt {
    return this.#view;
  }

  /** Moves there now; a flight ends. */
  set(view: LookAt): void {
    cancelAnimationFrame(this.#frame);
    this.#show(view);
  }

  flyTo(goal: LookAt): void {
    const from = this.#view;
    if (wantsNoMotion()) this.set(goal);
    else this.#play(FLIGHT_MS, (share) => (share < 1 ? between(from, goal, share) : goal));
  }

  /** Turns by `angle` (radians) to both sides and back, once, until `touched`; for a person who wants no motion not. */
  sway(angle: number, touched: AbortSignal): void {
    const from = this.#view;
    if (wantsNoMotion() || touched.aborted) return;
    touched.addEventListener("abort", () => cancelAnimationFrame(this.#frame));
    this.#play(SWAY_MS, (share) => (share < 1 ? orbit(from, angle * Math.sin(2 * Math.PI * share), 0) : from));
  }

  /** Shows the views of a way, 0..1, slowly at both ends. */
  #play(milliseconds: number, way: (share: number) => LookAt): void {
    cancelAnimationFrame(this.#frame);
    const begin = performance.now();
    const step = (now: number) => {
      const share = Math.min(1, Math.max(0, (now - begin) / milliseconds));
      this.#show(way(share * share * (3 - 2 * share)));
      if (share < 1) this.#frame = requestAnimationFrame(step);
    };
    this.#frame = requestAnimationFrame(step);
  }

  stop(): void {
    cancelAnimationFrame(this.#frame);
    cancelAnimationFrame(this.#drawn);
    window.clearTimeout(this.#timer);
  }

  #show(view: LookAt): void {
    this.#view = view;
    this.changed(view, false);
    this.rest();
  }

  /** Says that the camera rests, unless it moves by then. */
  rest(): void {
    window.clearTimeout(this.#timer);
    cancelAnimationFrame(this.#drawn);
    // Rest begins once this view has been drawn, however long that takes: by then the next one may be due.
    this.#drawn = requestAnimationFrame(() => {
      this.#drawn = requestAnimationFrame(() => {
        this.#timer = window.setTimeout(() => this.changed(this.#view, true), REST_MS);
      });
    });
  }
}
