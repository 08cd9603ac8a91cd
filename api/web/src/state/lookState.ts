import type { ReadonlySignal, Signal } from "@preact/signals";
import { batch, computed, signal } from "@preact/signals";

import { route } from "../address/router";
import { isAbort } from "../api/http";
import { listPhotos } from "../api/photoCalls";
import type { PosedCamera, Scene } from "../api/types";
import type { Mode } from "../viewer/colors";
import type { LookAt } from "../viewer/poses";
import { centerOfAttention, rayOf } from "../viewer/poses";
import type { Size } from "../viewer/projection";
import { viewOfPhoto } from "../viewer/projection";
import type { Vec } from "../viewer/vectors";
import { dot, subtract } from "../viewer/vectors";
import { lookText, parseLook } from "./lookAddress";

const NEAREST = 0.1;

/** What the look needs of the 3D view that it is about. */
interface Stage {
  canvas: HTMLCanvasElement;
  level: Vec;
  fly: (goal: LookAt) => void;
  jump: (goal: LookAt) => void;
  changed: () => void;
}

/** The scene that is looked at, as its state has it. */
interface LookedAt {
  readonly sceneId: string;
  readonly scene: ReadonlySignal<Scene | null>;
  readonly actionError: Signal<unknown>;
}

/** How a scene is looked at: what its colors say, whether its cameras are drawn, and which photo it is compared with. */
export class LookState {
  readonly mode = signal<Mode>("photo");
  readonly cameras = signal(false);
  /** Names of the cameras whose photos are stored; null while that is not known. */
  readonly photos = signal<ReadonlySet<string> | null>(null);
  /** The camera whose photo is compared with the scene, while the view stands there or flies there; empty for none. */
  readonly at = signal("");
  readonly standing = signal(false);
  /** How much of the picture is photo, from the left: 0..1. */
  readonly share = signal(0.5);
  readonly view = signal<LookAt | null>(null);
  readonly size = signal<Size>({ width: 0, height: 0 });
  /** Nearest and farthest depth that has a color of its own, scene units. */
  readonly depths = signal<readonly [number, number] | null>(null);

  readonly all = computed<readonly PosedCamera[]>(() => this.state.scene.value?.cameras ?? []);
  readonly camera = computed(() => this.all.value.find((camera) => camera.name === this.at.value) ?? null);

  #stage: Stage | null = null;
  #goal: LookAt | null = null;
  #loads = new AbortController();

  constructor(private readonly state: LookedAt) {}

  /** Begins with what the address says. */
  attach(stage: Stage): void {
    this.#stage = stage;
    this.#loads = new AbortController();
    stage.canvas.addEventListener("keydown", (event) => this.#key(event), { signal: this.#loads.signal });
    const { signal } = this.#loads;
    listPhotos(this.state.sceneId, "", signal).then(
      (photos) => (this.photos.value = photos),
      (error: unknown) => {
        if (!signal.aborted && !isAbort(error)) this.state.actionError.value = error;
      },
    );
    const current = route.peek();
    const look = parseLook(current.page === "scene" ? current.look : "");
    batch(() => {
      this.mode.value = look.mode;
      this.cameras.value = look.cameras;
      this.at.value = this.all.peek().some((camera) => camera.name === look.photo) ? look.photo : "";
    });
  }

  detach(): void {
    this.#loads.abort();
    this.#stage = this.#goal = null;
    this.standing.value = false;
  }

  /** The look as text for the address. */
  get text(): string {
    return lookText({ mode: this.mode.peek(), cameras: this.cameras.peek(), photo: this.at.peek() });
  }

  setMode(mode: Mode): void {
    this.mode.value = mode;
    this.#stage?.changed();
  }

  showCameras(shown: boolean): void {
    this.cameras.value = shown;
    this.#stage?.changed();
  }

  /** Flies to where a photo was taken. */
  goTo(name: string): void {
    batch(() => {
      this.standing.value = false;
      this.at.value = name;
    });
    this.#aim();
    if (this.#goal) this.#stage?.fly(this.#goal);
  }

  /** Flies to the photo that is `step` after the present one, or to the first. */
  step(step: number): void {
    const cameras = this.all.peek();
    const present = cameras.findIndex((camera) => camera.name === this.at.peek());
    const next = cameras[present < 0 ? 0 : (present + step + cameras.length) % cameras.length];
    if (next) this.goTo(next.name);
  }

  /** Stays where the photo was taken, without it. */
  leave(): void {
    batch(() => {
      this.standing.value = false;
      this.at.value = "";
    });
    this.#goal = null;
    this.#stage?.changed();
  }

  /** The 3D view shows another viewpoint; whoever moves away from a photo does not compare with it any longer. */
  moved(view: LookAt, resting: boolean): void {
    batch(() => {
      this.view.value = view;
      if (view === this.#goal) this.standing.value = true;
      else if (this.standing.peek() || (resting && this.#goal)) {
        this.standing.value = false;
        this.at.value = "";
        this.#goal = null;
      }
    });
  }

  /** The 3D view has another size: a photo is shown as a whole all the same. */
  resized(size: Size): void {
    const before = this.size.peek();
    if (size.width < 1 || size.height < 1 || (before.width === size.width && before.height === size.height)) return;
    this.size.value = size;
    const begins = this.at.peek() !== "" && this.#goal === null;
    if (!begins && !this.standing.peek()) return;
    this.#aim();
    if (this.#goal) this.#stage?.jump(this.#goal);
  }

  #aim(): void {
    const [camera, stage, size] = [this.camera.peek(), this.#stage, this.size.peek()];
    this.#goal = null;
    if (!camera || !stage || !size.width) return;
    const { position, forward } = rayOf(camera);
    const depth = dot(subtract(centerOfAttention(this.all.peek()), position), forward);
    this.#goal = viewOfPhoto(camera, Math.max(depth, NEAREST), stage.level, size);
  }

  #key(event: KeyboardEvent): void {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const step = { n: 1, p: -1 }[event.key.toLowerCase()];
    if (!step) return;
    event.preventDefault();
    this.step(step);
  }
}
