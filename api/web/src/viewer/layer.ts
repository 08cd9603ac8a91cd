import {
  Entity,
  GSplatData,
  GSplatResource,
  PIXELFORMAT_R8U,
  PIXELFORMAT_RGBA8,
  WORKBUFFER_UPDATE_ONCE,
} from "playcanvas";
import type { AppBase } from "playcanvas";

import type { SplatColumns } from "./spz";

/** What belongs to each Gaussian beside its own columns. */
export type Stream = "splatState" | "splatTint";

/** Gaussians in the engine: one splat with our two streams, a state and a tint of each. */
export class Layer {
  readonly #entity = new Entity("splat");
  readonly #resource: GSplatResource;

  constructor(app: AppBase, { count, columns }: SplatColumns, modifier: string) {
    const properties = [...columns].map(([name, storage]) => ({ type: "float", name, storage, byteSize: 4 }));
    const data = new GSplatData([{ name: "vertex", count, properties }]);
    this.#resource = new GSplatResource(app.graphicsDevice, data);
    this.#resource.format.addExtraStreams([
      { name: "splatState", format: PIXELFORMAT_R8U },
      { name: "splatTint", format: PIXELFORMAT_RGBA8 },
    ]);
    this.#entity.addComponent("gsplat", { resource: this.#resource });
    app.root.addChild(this.#entity);
    this.#entity.gsplat?.setWorkBufferModifier({ glsl: modifier });
  }

  get shown(): boolean {
    return this.#entity.enabled;
  }

  set shown(shown: boolean) {
    this.#entity.enabled = shown;
  }

  set(name: string, value: number | number[]): void {
    this.#entity.gsplat?.setParameter(name, value);
    this.recolor();
  }

  fill(stream: Stream, values: Uint8Array): void {
    const texture = this.#resource.getTexture(stream);
    if (!texture) return;
    (texture.lock() as Uint8Array).set(values);
    texture.unlock();
    this.recolor();
  }

  destroy(): void {
    this.#entity.destroy();
    this.#resource.destroy();
  }

  /** Has colors computed anew, from where the camera is then. */
  recolor(): void {
    if (this.#entity.gsplat) this.#entity.gsplat.workBufferUpdate = WORKBUFFER_UPDATE_ONCE;
  }
}
