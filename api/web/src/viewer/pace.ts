import { nextScale, SMALLEST } from "./pictureScale";

const MOST_MS = 50; // twenty pictures a second: with what the page computes beside them, fifteen
const QUICK_MS = 15; // of a coarse picture: these graphics are no software
const POLL_MS = 4;
const FIRST_SCALE = 0.5;
const SURE = 3; // slow pictures in a row

/** How long the graphics take for a picture, by fences in WebGL's queue: frames alone do not tell, they only wait in it. */
export class Pace {
  #fence: WebGLSync | null = null;
  #timer = 0;
  #begun = 0;
  #coarse = false;
  #slow: boolean | null = null; // until a picture tells
  #scale = FIRST_SCALE;
  #tooLong: number[] = [];

  /** @param tooSlow hears which share of the Gaussians would be quick enough, where the smallest pictures are not. */
  constructor(
    private readonly gl: WebGL2RenderingContext,
    private readonly tooSlow: (share: number) => void,
  ) {}

  /** Whether the last full picture, or one that is still being made, takes too long for a camera that moves. */
  get isSlow(): boolean {
    return this.#slow === true || (this.#fence !== null && !this.#coarse && performance.now() - this.#begun > MOST_MS);
  }

  /** Whether it was seen how quick the graphics are. */
  get isKnown(): boolean {
    return this.#slow !== null;
  }

  /** The share of the full sides in which a coarse picture comes quickly. */
  get scale(): number {
    return this.#scale;
  }

  /** Measures the picture that was just handed to the graphics, unless one is being measured. */
  drawn(coarse: boolean): void {
    if (this.#fence) return;
    const { gl } = this;
    this.#fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    [this.#begun, this.#coarse] = [performance.now(), coarse];
    const look = () => {
      if (!this.#fence) return;
      const state = gl.clientWaitSync(this.#fence, 0, 0);
      if (state === gl.TIMEOUT_EXPIRED) {
        this.#timer = window.setTimeout(look, POLL_MS);
        return;
      }
      gl.deleteSync(this.#fence);
      this.#fence = null;
      const milliseconds = performance.now() - this.#begun;
      if (coarse) {
        this.#count(milliseconds);
        this.#scale = nextScale(this.#scale, milliseconds, MOST_MS);
        if (milliseconds < QUICK_MS) this.#slow ??= false; // until a full picture tells otherwise
      } else this.#slow = milliseconds > MOST_MS;
    };
    this.#timer = window.setTimeout(look, POLL_MS);
  }

  /** Counts slow ones of the smallest pictures: one alone may have waited for something else. */
  #count(milliseconds: number): void {
    this.#tooLong = this.#scale <= SMALLEST && milliseconds > MOST_MS ? [...this.#tooLong, milliseconds] : [];
    if (this.#tooLong.length < SURE) return;
    this.tooSlow(MOST_MS / Math.min(...this.#tooLong));
    this.#tooLong = [];
  }

  stop(): void {
    window.clearTimeout(this.#timer);
    if (this.#fence) this.gl.deleteSync(this.#fence);
    this.#fence = null;
  }
}
