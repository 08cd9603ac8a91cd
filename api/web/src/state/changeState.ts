import { computed, signal } from "@preact/signals";

import type { Measurement, Place, PosedCamera } from "../api/types";
import type { Motion } from "../viewer/motions";
import type { LookAt } from "../viewer/poses";
import { cameraOf } from "../viewer/poses";

/** A place in the picture on show, as the service takes it. */
export interface SeenPlace {
  camera: PosedCamera;
  pixel: { x: number; y: number };
}

/** An object that is being split, or one that is missing, by clicks in the view. */
export interface PromptTool {
  kind: "split" | "add";
  /** Of the object that is split; 0 for a missing one. */
  object: number;
  /** What the clicks so far have made; null before the first. */
  made: { id: number; count: number; version: string } | null;
  places: readonly SeenPlace[];
}

/** Two places that are measured between, as they were picked, and what the server says of them. */
export interface RulerTool {
  places: readonly Place[];
  measured: Measurement | null;
  error: unknown;
  waiting: boolean;
}

/** What is being changed and how the view takes part in it; nothing of it is a version until it is sent. */
export class ChangeState {
  /** Objects that are not shown, and those that alone are; neither is a change of the scene. */
  readonly hidden = signal<ReadonlySet<number>>(new Set());
  readonly isolated = signal<ReadonlySet<number> | null>(null);
  /** How the selected objects are moved on show. */
  readonly motion = signal<Motion | null>(null);
  /** Clicks that say where an object is, see `prompts.ts`. */
  readonly prompt = signal<PromptTool | null>(null);
  /** Objects that the pointer has been drawn over, while they are marked so; null while they are not. */
  readonly brush = signal<readonly number[] | null>(null);
  /** Bytes, 1 for Gaussians that would go if what is set was done; they are not shown. */
  readonly going = signal<Uint8Array | null>(null);
  /** What is measured; null while nothing is. */
  readonly ruler = signal<RulerTool | null>(null);
  /** Takes the next clicks in the view instead of selecting objects; null for none. */
  readonly onPlace = signal<((place: SeenPlace) => void) | null>(null);

  /** From where the scene is looked at, and the picture's size on the page. */
  readonly view = signal<LookAt | null>(null);
  readonly size = signal({ width: 0, height: 0 });

  readonly hides = computed(() => this.hidden.value.size > 0 || this.isolated.value !== null);

  /** Whether Gaussians of an object (0: of none) are shown. */
  shows(object: number): boolean {
    const isolated = this.isolated.value;
    return !this.hidden.value.has(object) && (isolated === null || isolated.has(object));
  }

  hide(ids: readonly number[]): void {
    this.hidden.value = new Set([...this.hidden.value, ...ids]);
  }

  isolate(ids: readonly number[]): void {
    this.hidden.value = new Set();
    this.isolated.value = new Set(ids);
  }

  showAll(): void {
    this.hidden.value = new Set();
    this.isolated.value = null;
  }

  /** What the crosshair in the middle of the view is on. */
  middle(): SeenPlace | null {
    const [view, { width, height }] = [this.view.value, this.size.value];
    if (!view || !width || !height) return null;
    const ratio = Math.min(1, LONGEST_SIDE / Math.max(width, height));
    const [w, h] = [Math.max(1, Math.round(width * ratio)), Math.max(1, Math.round(height * ratio))];
    return { camera: cameraOf(view, w, h), pixel: { x: w / 2, y: h / 2 } };
  }
}

const LONGEST_SIDE = 640;
