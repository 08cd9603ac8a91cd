import { renderPicture } from "../api/calls";
import { ApiError, isAbort } from "../api/http";
import type { SceneSummary, Tint } from "../api/types";
import { DIMMED, TINTS } from "../viewer/glow";
import { nextScale, pictureSize } from "../viewer/pictureScale";
import type { LookAt } from "../viewer/poses";
import { cameraOf } from "../viewer/poses";

const MOST_PIXELS = 1_000_000; // more is costly work to a server
const LARGE = 90_000; // Gaussians of a scene that the server draws in fewer while the camera moves
const SLOW_MS = 110; // nine pictures a second
const RETRY_MS = 1_000;
const SERVER_ERRORS = 500;
const TOO_MANY = 429;

/** What is shown: of which version, and which objects are found, pointed at and selected. */
export interface Shown {
  version: string;
  found: readonly number[];
  /** Whether all that is not marked recedes. */
  dimmed: boolean;
  hovered: number;
  selected: readonly number[];
}

/**
 * Shows the server's pictures where the browser does not draw yet, or cannot: one request at a time, then the newest
 * view. While the camera moves they are as large as they come quickly (so are large scenes' Gaussians), then full size.
 */
export class ServerView {
  readonly #ended = new AbortController();
  #view: LookAt | null = null;
  #shown: Shown | null = null;
  #size: [number, number] = [0, 0];
  #resting = true;
  #due = false;
  #running = false;
  #scale = 1;
  #drawnInFull = false;

  /** Pictures replace each other in `place`; `drawn` gets what one shows once it is there, or why there is none. */
  constructor(
    private readonly place: HTMLElement,
    private readonly scene: Pick<SceneSummary, "id" | "gaussians">,
    private readonly drawn: (shown: Shown | null, error: unknown) => void,
  ) {}

  /** Looks from somewhere else; at rest the picture is drawn anew only if the last one was a small one. */
  setView(view: LookAt, resting: boolean): void {
    if (resting && view === this.#view && this.#drawnInFull && !this.#due) {
      this.#resting = true;
      return;
    }
    [this.#view, this.#resting] = [view, resting];
    this.#draw();
  }

  /** The canvas' size in pixels. */
  setSize(width: number, height: number): void {
    if (width < 1 || height < 1) return;
    this.#size = [width, height];
    this.#draw();
  }

  show(shown: Shown): void {
    if (JSON.stringify(shown) === JSON.stringify(this.#shown)) return;
    this.#shown = shown;
    this.#draw();
  }

  /** Takes its picture away. */
  destroy(): void {
    this.#ended.abort();
    this.place.replaceChildren();
  }

  #over(): boolean {
    return this.#ended.signal.aborted;
  }

  #draw(): void {
    this.#due = true;
    if (!this.#running) void this.#run();
  }

  async #run(): Promise<void> {
    this.#running = true;
    while (this.#due && !this.#over()) {
      const [view, shown, [width, height]] = [this.#view, this.#shown, this.#size];
      if (!view || !shown || !width) break; // asked again as soon as that is known
      this.#due = false;
      const scale = this.#resting ? 1 : this.#scale;
      const coarse = !this.#resting && this.scene.gaussians > LARGE;
      try {
        const begin = performance.now();
        await this.#picture(view, shown, coarse, pictureSize(width, height, scale, MOST_PIXELS));
        this.#drawnInFull = scale === 1 && !coarse;
        this.#scale = nextScale(scale, performance.now() - begin, SLOW_MS);
        if (!this.#over()) this.drawn(shown, null);
      } catch (error) {
        if (this.#over() || isAbort(error)) break;
        this.drawn(null, error);
        const lasting = error instanceof ApiError && error.status < SERVER_ERRORS && error.status !== TOO_MANY;
        if (lasting) continue; // it would be refused again
        await new Promise((resolve) => window.setTimeout(resolve, RETRY_MS));
        this.#due = true;
      }
    }
    this.#running = false;
  }

  async #picture(view: LookAt, shown: Shown, coarse: boolean, [w, h]: [number, number]): Promise<void> {
    const more = {
      format: "jpeg" as const,
      version: shown.version,
      tints: tintsOf(shown),
      dimming: shown.dimmed ? 1 - DIMMED : 0,
      coarse,
    };
    const blob = await renderPicture(this.scene.id, cameraOf(view, w, h), this.#ended.signal, more);
    const picture = new Image();
    picture.src = URL.createObjectURL(blob);
    await picture.decode().finally(() => URL.revokeObjectURL(picture.src));
    if (this.#over()) return;
    this.place.replaceChildren(picture);
  }
}

/** Tints of the contract; the last one of an object holds. */
function tintsOf(shown: Shown): Tint[] {
  const marked: [readonly number[], { color: readonly number[]; strength: number }][] = [
    [shown.found, TINTS.found],
    [shown.hovered ? [shown.hovered] : [], TINTS.hovered],
    [shown.selected, TINTS.selected],
  ];
  return marked.flatMap(([objects, { color, strength }]) => {
    const [r = 0, g = 0, b = 0] = color;
    return objects.length ? [{ object_ids: [...objects], color: { r, g, b }, strength }] : [];
  });
}
