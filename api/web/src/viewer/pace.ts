const SLOW_MS = 120;
const POLL_MS = 8;

/** How long the graphics take for a picture, by fences in WebGL's queue: frames alone do not tell, they only wait in it. */
export class Pace {
  #fence: WebGLSync | null = null;
  #timer = 0;
  #begun = 0;
  #slow = false;

  constructor(private readonly gl: WebGL2RenderingContext) {}

  /** Whether the last picture, or one that is still being made, takes so long that no camera can be moved by it. */
  get isSlow(): boolean {
    return this.#slow || (this.#fence !== null && performance.now() - this.#begun > SLOW_MS);
  }

  /** Measures the picture that was just handed to the graphics, unless one is being measured. */
  drawn(): void {
    if (this.#fence) return;
    const { gl } = this;
    this.#fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    this.#begun = performance.now();
    const look = () => {
      if (!this.#fence) return;
      const state = gl.clientWaitSync(this.#fence, 0, 0);
      if (state === gl.TIMEOUT_EXPIRED) {
        this.#timer = window.setTimeout(look, POLL_MS);
        return;
      }
      gl.deleteSync(this.#fence);
      this.#fence = null;
      this.#slow = performance.now() - this.#begun > SLOW_MS;
    };
    this.#timer = window.setTimeout(look, POLL_MS);
  }

  stop(): void {
    window.clearTimeout(this.#timer);
    if (this.#fence) this.gl.deleteSync(this.#fence);
    this.#fence = null;
  }
}
