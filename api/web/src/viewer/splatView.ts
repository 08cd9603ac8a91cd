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
  PIXELFORMAT_RGBA8,
  Quat,
  TONEMAP_NONE,
  WORKBUFFER_UPDATE_ONCE,
} from "playcanvas";

import type { Motion } from "../change/motions";
import { matrixOf, turnOf } from "../change/motions";
import { DEPTH_STOPS } from "../look/colors";
import { DepthRange } from "./depthRange";
import type { Tint } from "./glow";
import { DIMMED, TINTS } from "./glow";
import type { SplatColumns } from "./spz";
import type { LookAt } from "./poses";
import { axesOf, FIELD_OF_VIEW } from "./poses";
import { length, subtract } from "./vectors";

const vec3 = (values: readonly number[]): string => `vec3(${values.map((value) => value.toFixed(4)).join(", ")})`;

const tinted = ({ color, strength }: Tint): string => `mix(color.rgb, ${vec3(color)}, ${strength.toFixed(4)})`;

const DEPTH_COLORS = `vec3[](${DEPTH_STOPS.map((stop) => vec3(stop.map((byte) => byte / 255))).join(", ")})`;

/** What a Gaussian's color says, as the uniform `uColors`. */
const COLORINGS = { own: 0, tint: 1, depth: 2 };

/** The engine calls these three while it copies the splats into its work buffer; `loadSplat...` read our streams. */
const MODIFIER = `
uniform float uDimmed;
uniform float uColors;
uniform vec3 uEye;
uniform vec3 uForward;
uniform vec2 uDepths;
const vec3 DEPTH_COLORS[${DEPTH_STOPS.length}] = ${DEPTH_COLORS};
vec3 depthColor(float depth) {
    float place = clamp((depth - uDepths.x) / (uDepths.y - uDepths.x), 0.0, 1.0) * ${(DEPTH_STOPS.length - 1).toFixed(1)};
    int stop = min(int(place), ${DEPTH_STOPS.length - 2});
    return mix(DEPTH_COLORS[stop], DEPTH_COLORS[stop + 1], place - float(stop));
}
uniform mat4 uMotion;
uniform vec4 uTurn;
void modifySplatCenter(inout vec3 center) {
    if (uint(loadSplatState().r) == 3u) center = (uMotion * vec4(center, 1.0)).xyz;
}
void modifySplatRotationScale(vec3 originalCenter, vec3 modifiedCenter, inout vec4 rotation, inout vec3 scale) {
    if (uint(loadSplatState().r) != 3u) return;
    rotation = quatMul(uTurn, rotation);
    if (rotation.w < 0.0) rotation = -rotation;
}
void modifySplatColor(vec3 center, inout vec4 color) {
    float light = dot(clamp(color.rgb, 0.0, 1.0), vec3(0.299, 0.587, 0.114));
    if (uColors > 1.5) color.rgb = depthColor(dot(center - uEye, uForward));
    else if (uColors > 0.5) color.rgb = loadSplatTint().rgb * (0.6 + 0.5 * light);
    uint state = uint(loadSplatState().r);
    if (state == 1u) color.rgb = ${tinted(TINTS.found)};
    else if (state == 2u) color.rgb = ${tinted(TINTS.hovered)};
    else if (state == 3u) color.rgb = ${tinted(TINTS.selected)};
    else if (state == 4u) color.a = 0.0;
    else color.rgb *= uDimmed;
}
`;

/** WebGL is not there, so that the browser can draw nothing. */
export class NoWebGLError extends Error {}

/**
 * A Gaussian as it was trained and as the server draws it, exp(-d²/2): the engine's own fall-off is lower towards the rim,
 * so that things would have a fainter outline and let more of what is behind them through.
 */
const FALL_OFF = `
void modifySplatColor(vec2 gaussianUV, inout vec4 color) {
    color.a = exp(-4.0 * dot(gaussianUV, gaussianUV)) * gaussianColor.a;
}
`;

/** Draws one splat on a canvas, when something has changed and not before. */
export class SplatView {
  readonly #app: AppBase;
  readonly #camera: Entity;
  #splat: Entity | null = null;
  #resource: GSplatResource | null = null;
  #view: LookAt | null = null;
  #depthRange: DepthRange | null = null;
  #onDepths: ((range: readonly [number, number]) => void) | null = null;
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
    this.#app.scene.gsplat.material.getShaderChunks("glsl").set("gsplatModifyPS", FALL_OFF);
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
    resource.format.addExtraStreams([
      { name: "splatState", format: PIXELFORMAT_R8U },
      { name: "splatTint", format: PIXELFORMAT_RGBA8 },
    ]);
    const entity = new Entity("splat");
    entity.addComponent("gsplat", { resource });
    this.#app.root.addChild(entity);
    this.#depthRange = new DepthRange(columns);
    entity.gsplat?.setParameter("uDimmed", 1);
    entity.gsplat?.setParameter("uColors", COLORINGS.own);
    entity.gsplat?.setParameter("uEye", [0, 0, 0]);
    entity.gsplat?.setParameter("uForward", [0, 0, 1]);
    entity.gsplat?.setParameter("uDepths", [0, 1]);
    this.#setMotion(entity, null);
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
    this.#splat.gsplat.setParameter("uDimmed", dimmed ? DIMMED : 1);
    this.#update();
  }

  /** Shows the Gaussians' own colors. */
  setOwnColors(): void {
    this.#recolor(COLORINGS.own, null);
  }

  /** Shows the Gaussians in other colors: red, green, blue and 255 each, by row. */
  setTints(tints: Uint8Array): void {
    const texture = this.#resource?.getTexture("splatTint");
    if (!texture) return;
    (texture.lock() as Uint8Array).set(tints);
    texture.unlock();
    this.#recolor(COLORINGS.tint, null);
  }

  /** Shows how far the Gaussians are along the view; `told` hears which depths the first and the last color stand for. */
  setDepthColors(told: (range: readonly [number, number]) => void): void {
    this.#recolor(COLORINGS.depth, told);
    this.#measure();
  }

  #recolor(coloring: number, told: ((range: readonly [number, number]) => void) | null): void {
    this.#onDepths = told;
    this.#splat?.gsplat?.setParameter("uColors", coloring);
    this.#update();
  }

  /** Follows the view with the depths' colors. */
  #measure(): void {
    const gsplat = this.#splat?.gsplat;
    if (!this.#onDepths || !this.#view || !this.#depthRange || !gsplat) return;
    const { forward } = axesOf(this.#view);
    const range = this.#depthRange.of(this.#view);
    gsplat.setParameter("uEye", [...this.#view.position]);
    gsplat.setParameter("uForward", [...forward]);
    gsplat.setParameter("uDepths", [...range]);
    this.#onDepths(range);
    this.#update();
  }

  #update(): void {
    if (this.#splat?.gsplat) this.#splat.gsplat.workBufferUpdate = WORKBUFFER_UPDATE_ONCE;
    this.redraw();
  }

  /** Shows the selected Gaussians moved, or where they are. */
  setMotion(motion: Motion | null): void {
    if (!this.#splat?.gsplat) return;
    this.#setMotion(this.#splat, motion);
    this.#splat.gsplat.workBufferUpdate = WORKBUFFER_UPDATE_ONCE;
    this.redraw();
  }

  #setMotion(splat: Entity, motion: Motion | null): void {
    const shown = motion ?? { pivot: [0, 0, 0], shift: [0, 0, 0], angles: [0, 0, 0] };
    const turn = turnOf(shown);
    splat.gsplat?.setParameter("uMotion", matrixOf(shown));
    splat.gsplat?.setParameter("uTurn", [turn.x, turn.y, turn.z, turn.w]);
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
      camera.fov = view.fieldOfView ?? FIELD_OF_VIEW;
    }
    this.#measure();
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
