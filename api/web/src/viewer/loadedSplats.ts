import type { SeenSplat } from "./readSplat";

const KEPT = 2;

/** The splats that were shown last, so that going to and fro between two versions asks the server once for each. */
export class LoadedSplats {
  readonly #splats = new Map<string, SeenSplat>();

  /** The splat of this scene and version; `load` brings one that is not here. */
  async get(version: string, load: () => Promise<SeenSplat>): Promise<SeenSplat> {
    const splat = this.#splats.get(version) ?? (await load());
    this.#splats.delete(version);
    this.#splats.set(version, splat);
    for (const oldest of [...this.#splats.keys()].slice(0, -KEPT)) this.#splats.delete(oldest);
    return splat;
  }
}
