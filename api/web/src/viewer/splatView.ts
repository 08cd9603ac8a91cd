import {
  AppBase,
  AppOptions,
  CameraComponentSystem,
  Color,
  createGraphicsDevice,
  Entity,
  GAMMA_SRGB,
  GSplatComponentSystem,
  GSplatData,
  GSplatResource,
  Mat4,
  PIXELFORMAT_R8U,
  Quat,
  TONEMAP_NONE,
  WORKBUFFER_UPDATE_ONCE,
} from "playcanvas";

import type { SplatColumns } from "./spz";
import type { LookAt } from "./poses";
import { axesOf, FIELD_OF_VIEW } from "./poses";
import { length, subtract } from "./vectors";

/** How strongly a state's color covers a Gaussian's own, and what is left of the others' brightness meanwhile. */
export const GLOW = { strength: 0.75, dimmed: 0.45 };

/** Colors of the states found, hovered and selected: red, green, blue, 0..1. */
const COLORS = { found: [1, 0.56, 0.06], hovered: [0.35, 0.85, 1], selected: [0.1, 0.55, 1] };

const vec3 = (values: number[]): string => `vec3(${values.map((value) => value.toFixed(4)).join(", ")})`;

/** The engine calls these three while it copies the splats into its work buffer; `loadSplatState` reads our stream. */
const MODIFIER = `
uniform float uDimmed;
void modifySplatCenter(inout vec3 center) {}
void modifySplatRotationScale(vec3 originalCenter, vec3 modifiedCenter, inout vec4 rotation, inout vec3 scale) {}
void modifySplatColor(vec3 center, inout vec4 color) {
    uint state = uint(loadSplatState().r);
    if (state == 1u) color.rgb = mix(color.rgb, ${vec3(COLORS.found)}, ${GLOW.strength.toFixed(3)});
    else if (state == 2u) color.rgb = mix(color.rgb, ${vec3(COLORS.hovered)}, 0.55);
    else if (state == 3u) color.rgb = mix(color.rgb, ${vec3(COLORS.selected)}, 0.65);
    else color.rgb *= uDimmed;
}
`;

/** WebGL is not there, so that nothing can be drawn. */
export class NoWebGLError extends Error {}

/** Draws one splat on a canvas, when something has changed and not before. */
export class SplatView {
  readonly #app: AppBase;
  readonly #camera: Entity;
  #splat: Entity | null = null;
  #resource: GSplatResource | null = null;
  #view: LookAt | null = null;
  #size = "";

  /** @throws NoWebGLError the browser has no WebGL 2. */
  static async create(canvas: HTMLCanvasElement): Promise<SplatView> {
    const device = await createGraphicsDevice(canvas, {
      deviceTypes: ["webgl2"],
      antialias: false,
    }).catch((error: unknown) => {
      throw new NoWebGLError(String(error));
    });
    return new SplatView(canvas, device);
  }

  private constructor(canvas: HTMLCanvasElement, device: AppOptions["graphicsDevice"]) {
    const options = new AppOptions();
    options.graphicsDevice = device;
    options.componentSystems = [CameraComponentSystem, GSplatComponentSystem];
    this.#app = new AppBase(canvas);
    this.#app.init(options);
    this.#app.autoRender = false;
    this.#app.scene.gsplat.minPixelSize = 0;
    this.#app.scene.gsplat.minContribution = 0;
    this.#camera = new Entity("camera");
    this.#camera.addComponent("camera", {
      clearColor: new Color(0, 0, 0, 1),
      gammaCorrection: GAMMA_SRGB,
      toneMapping: TONEMAP_NONE,
      fov: FIELD_OF_VIEW,
    });
    this.#app.root.addChild(this.#camera);
    // The order of the splats comes from a worker; the picture is due again when it has arrived.
    this.#app.systems.gsplat?.on("frame:request", () => this.redraw());
    this.#app.start();
  }

  /** Shows these Gaussians instead of those before. */
  setSplat({ count, columns }: SplatColumns): void {
    this.#removeSplat();
    const properties = [...columns].map(([name, storage]) => ({ type: "float", name, storage, byteSize: 4 }));
    const data = new GSplatData([{ name: "vertex", count, properties }]);
    const resource = new GSplatResource(this.#app.graphicsDevice, data);
    resource.format.addExtraStreams([{ name: "splatState", format: PIXELFORMAT_R8U }]);
    const entity = new Entity("splat");
    entity.addComponent("gsplat", { resource });
    this.#app.root.addChild(entity);
    entity.gsplat?.setParameter("uDimmed", 1);
    entity.gsplat?.setWorkBufferModifier({ glsl: MODIFIER });
    [this.#splat, this.#resource] = [entity, resource];
    this.redraw();
  }

  /** Shows a state of each Gaussian (see `states.ts`), by row; with `dimmed`, those without one recede. */
  setStates(states: Uint8Array, dimmed: boolean): void {
    const texture = this.#resource?.getTexture("splatState");
    if (!texture || !this.#splat?.gsplat) return;
    (texture.lock() as Uint8Array).set(states);
    texture.unlock();
    this.#splat.gsplat.setParameter("uDimmed", dimmed ? GLOW.dimmed : 1);
    this.#splat.gsplat.workBufferUpdate = WORKBUFFER_UPDATE_ONCE;
    this.redraw();
  }

  /** Looks from somewhere else. */
  setView(view: LookAt): void {
    this.#view = view;
    const { right, down, forward } = axesOf(view);
    const columns = new Mat4();
    // The engine's cameras look along -z with y up.
    columns.data.set([...right, 0, ...down.map((v) => -v), 0, ...forward.map((v) => -v), 0, ...view.position, 1]);
    this.#camera.setPosition(...view.position);
    this.#camera.setRotation(new Quat().setFromMat4(columns));
    const distance = length(subtract(view.target, view.position));
    const camera = this.#camera.camera;
    if (camera) {
      camera.nearClip = distance / 200;
      camera.farClip = distance * 2_000;
    }
    this.redraw();
  }

  /** The picture's size in device pixels; the field of view is that of its longer side. */
  setSize(width: number, height: number): void {
    if (this.#size === `${width}x${height}` || width < 1 || height < 1) return;
    this.#size = `${width}x${height}`;
    this.#app.graphicsDevice.setResolution(width, height);
    if (this.#camera.camera) this.#camera.camera.horizontalFov = width >= height;
    if (this.#view) this.setView(this.#view);
  }

  redraw(): void {
    this.#app.renderNextFrame = true;
  }

  destroy(): void {
    this.#removeSplat();
    this.#app.destroy();
  }

  #removeSplat(): void {
    this.#splat?.destroy();
    this.#resource?.destroy();
    this.#splat = this.#resource = null;
  }
}
