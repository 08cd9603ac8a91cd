import {
  AppBase,
  AppOptions,
  CameraComponentSystem,
  Color,
  createGraphicsDevice,
  Entity,
  GAMMA_SRGB,
  GSplatComponentSystem,
  Mat4,
  Quat,
  TONEMAP_NONE,
} from "playcanvas";

import { DEPTH_STOPS } from "./colors";
import { DepthRange } from "./depthRange";
import type { Draft } from "./draft";
import { draftOf, ofRows, thinner } from "./draft";
import type { Tint } from "./glow";
import { DIMMED, TINTS } from "./glow";
import type { Stream } from "./layer";
import { Layer } from "./layer";
import type { Motion } from "./motions";
import { matrixOf, turnOf } from "./motions";
import { Pace } from "./pace";
import type { LookAt } from "./poses";
import { axesOf, FIELD_OF_VIEW } from "./poses";
import type { SplatColumns } from "./spz";
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

/** More Gaussians than this are many to a slow machine. */
const MANY = 120_000;

/** What a Gaussian adds less of is not drawn while the camera moves: most of the work, and hardly anything to see. */
const FAINT = { moving: 0.04, resting: 1 / 255 };

/** exp(-d²/2), as in training and on the server; the engine's is lower at rims: fainter, and more seen through. */
const FALL_OFF = `
void modifySplatColor(vec2 gaussianUV, inout vec4 color) {
    color.a = exp(-4.0 * dot(gaussianUV, gaussianUV)) * gaussianColor.a;
}
`;

/** Draws one splat on a canvas, when something has changed and not before. */
export class SplatView {
  readonly #app: AppBase;
  readonly #camera: Entity;
  readonly #pace: Pace;
  #full: Layer | null = null;
  #draft: (Draft & { layer: Layer }) | null = null;
  #coarse = false;
  #scale = 1;
  #count = 0;
  readonly #uniforms = new Map<string, number | number[]>();
  readonly #streams = new Map<Stream, readonly [values: Uint8Array, width: number]>();
  #view: LookAt | null = null;
  #depthRange: DepthRange | null = null;
  #columns: ReadonlyMap<string, Float32Array> = new Map();
  #onDepths: ((range: readonly [number, number]) => void) | null = null;
  #size: [number, number] = [0, 0];

  /** @param gl of the canvas, which the engine finds there. */
  static async create(canvas: HTMLCanvasElement, gl: WebGL2RenderingContext): Promise<SplatView> {
    const device = await createGraphicsDevice(canvas, { deviceTypes: ["webgl2"], antialias: false });
    return new SplatView(canvas, device, gl);
  }

  private constructor(canvas: HTMLCanvasElement, device: AppOptions["graphicsDevice"], gl: WebGL2RenderingContext) {
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
    this.#pace = new Pace(gl, (share) => this.#thinDraft(share));
    this.#app.on("postrender", () => {
      if (this.#full) this.#pace.drawn(this.#coarse);
    });
    this.#app.start();
  }

  /** Shows these Gaussians instead of those before. */
  setSplat(splat: SplatColumns): void {
    this.#removeSplat();
    this.#depthRange = new DepthRange(splat.columns);
    this.#columns = splat.columns;
    this.#count = splat.count;
    this.#full = new Layer(this.#app, splat, MODIFIER);
    this.#streams.clear();
    const draft = draftOf(splat);
    if (draft) this.#addDraft(draft);
    this.#set("uDimmed", 1);
    this.#set("uColors", COLORINGS.own);
    this.#set("uEye", [0, 0, 0]);
    this.#set("uForward", [0, 0, 1]);
    this.#set("uDepths", [0, 1]);
    this.#setMotion(null);
    if (draft)
      this.#showCoarse(true); // drawn soon, and the engine is ready for it when the camera moves
    else this.#resize();
  }

  #addDraft(draft: Draft): void {
    const layer = new Layer(this.#app, draft.splat, MODIFIER);
    layer.shown = false;
    for (const [name, value] of this.#uniforms) layer.set(name, value);
    for (const [stream, [values, width]] of this.#streams) layer.fill(stream, ofRows(values, draft.rows, width));
    this.#draft = { ...draft, layer };
  }

  /** Goes on with a share of the draft's Gaussians, where even small pictures of all of them take too long. */
  #thinDraft(share: number): void {
    const [before, after] = [this.#draft, this.#draft && thinner(this.#draft, share)];
    if (!before || !after) return;
    this.#addDraft(after);
    if (this.#draft) this.#draft.layer.shown = before.layer.shown;
    before.layer.destroy();
    this.redraw();
  }

  /** Shows a state of each Gaussian (see `states.ts`), by row; with `dimmed`, those without one recede. */
  setStates(states: Uint8Array, dimmed: boolean): void {
    this.#fill("splatState", states, 1);
    this.#set("uDimmed", dimmed ? DIMMED : 1);
    this.redraw();
  }

  /** Shows the Gaussians' own colors. */
  setOwnColors(): void {
    this.#recolor(COLORINGS.own, null);
  }

  /** Shows the Gaussians in other colors: red, green, blue and 255 each, by row. */
  setTints(tints: Uint8Array): void {
    this.#fill("splatTint", tints, 4);
    this.#recolor(COLORINGS.tint, null);
  }

  /** Shows how far the Gaussians are along the view; `told` hears which depths the first and the last color stand for. */
  setDepthColors(told: (range: readonly [number, number]) => void): void {
    this.#recolor(COLORINGS.depth, told);
    this.#measure();
  }

  /** The Gaussians on show, as the columns of a 3DGS PLY. */
  get columns(): ReadonlyMap<string, Float32Array> {
    return this.#columns;
  }

  /** Whether a picture takes so long that not every object that the pointer passes is worth one. */
  get sparesPictures(): boolean {
    return this.#pace.isSlow && this.#count > MANY;
  }

  /** Whether Gaussians are left out, or pixels. */
  get showsDraft(): boolean {
    return this.#coarse;
  }

  #recolor(coloring: number, told: ((range: readonly [number, number]) => void) | null): void {
    this.#onDepths = told;
    this.#set("uColors", coloring);
    this.redraw();
  }

  /** Follows the view with the depths' colors. */
  #measure(): void {
    if (!this.#onDepths || !this.#view || !this.#depthRange) return;
    const { forward } = axesOf(this.#view);
    const range = this.#depthRange.of(this.#view);
    this.#set("uEye", [...this.#view.position]);
    this.#set("uForward", [...forward]);
    this.#set("uDepths", [...range]);
    this.#onDepths(range);
  }

  #set(name: string, value: number | number[]): void {
    this.#uniforms.set(name, value);
    this.#full?.set(name, value);
    this.#draft?.layer.set(name, value);
  }

  /** Shows the selected Gaussians moved, or where they are. */
  setMotion(motion: Motion | null): void {
    this.#setMotion(motion);
    this.redraw();
  }

  #setMotion(motion: Motion | null): void {
    const shown = motion ?? { pivot: [0, 0, 0], shift: [0, 0, 0], angles: [0, 0, 0] };
    const turn = turnOf(shown);
    this.#set("uMotion", [...matrixOf(shown)]);
    this.#set("uTurn", [turn.x, turn.y, turn.z, turn.w]);
  }

  #fill(stream: Stream, values: Uint8Array, width: number): void {
    this.#streams.set(stream, [values, width]);
    this.#full?.fill(stream, values);
    if (this.#draft) this.#draft.layer.fill(stream, ofRows(values, this.#draft.rows, width));
  }

  /** Draws all Gaussians in full resolution, or the draft (of a small scene all of them) in less of it. */
  #showCoarse(coarse: boolean): void {
    const scale = coarse ? this.#pace.scale : 1;
    if (!this.#full || (this.#coarse === coarse && this.#scale === scale)) return;
    [this.#coarse, this.#scale] = [coarse, scale];
    if (this.#draft) {
      this.#draft.layer.shown = coarse;
      this.#full.shown = !coarse;
    }
    this.#app.scene.gsplat.alphaClipForward = coarse ? FAINT.moving : FAINT.resting;
    this.#resize();
  }

  /** Looks from somewhere else; the camera moves on unless it is `resting`. */
  setView(view: LookAt, resting = false): void {
    this.#showCoarse(!resting && (this.#pace.isSlow || (this.#draft !== null && !this.#pace.isKnown)));
    // While the camera moves, the engine keeps the colors of some viewpoint nearby: at rest they are those of this one.
    if (resting) this.#full?.recolor();
    if (this.#view === view) {
      this.redraw();
      return;
    }
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
    if (this.#size[0] === width && this.#size[1] === height) return;
    if (width < 1 || height < 1) return;
    this.#size = [width, height];
    this.#resize();
  }

  #resize(): void {
    const [width, height] = this.#size;
    const scale = this.#scale;
    this.#app.graphicsDevice.setResolution(Math.ceil(width * scale), Math.ceil(height * scale));
    if (this.#camera.camera) this.#camera.camera.horizontalFov = width >= height;
    this.redraw();
  }

  redraw(): void {
    this.#app.renderNextFrame = true;
  }

  /** Calls back once the Gaussians are drawn in their order. */
  onceDrawn(drawn: () => void): void {
    const system = this.#app.systems.gsplat;
    const frame = (_camera: unknown, _layer: unknown, ready: boolean) => {
      if (!ready) return;
      system?.off("frame:ready", frame);
      drawn();
    };
    system?.on("frame:ready", frame);
    this.redraw();
  }

  destroy(): void {
    this.#pace.stop();
    this.#removeSplat();
    this.#app.destroy();
  }

  #removeSplat(): void {
    this.#full?.destroy();
    this.#draft?.layer.destroy();
    this.#full = this.#draft = null;
    [this.#coarse, this.#scale] = [false, 1];
  }
}
