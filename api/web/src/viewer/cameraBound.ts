import type { PosedCamera } from "../api/types";
import type { LookAt } from "./poses";
import { centerOfAttention, rayOf } from "./poses";
import type { Sightings } from "./seenField";
import { SeenField } from "./seenField";
import { add, dot, scale, subtract } from "./vectors";

/** A gesture, or a share of it: the view that it leads to. */
export type Gesture = (share: number) => LookAt;

const FLOOR = 0.7; // of the picture, as it is counted here, so that 0.6 of it was surely seen
const OF_PHOTOS = 0.9; // of what is usual in the scene's own photos, where that is less
const SOFT = 0.12; // above the floor: there a gesture moves the less, the nearer the floor is
const STEPS = 5;
const SHARES = 16;
const LEAST = 0.12; // of a gesture that leads closer to the floor
const NOTHING = 0.25; // coverage of a picture that shows hardly anything that was seen

/** Width by height of a picture on the page. */
export function aspectOf({ clientWidth, clientHeight }: { clientWidth: number; clientHeight: number }): number {
  return Math.max(clientWidth, 1) / Math.max(clientHeight, 1);
}

/** Keeps the camera where pictures show what photos have seen. */
export class CameraBound {
  /** The least share of a picture to be covered; 0 for a scene without photos. */
  readonly floor: number;

  readonly #field: SeenField;

  constructor(
    seen: Sightings,
    cameras: readonly PosedCamera[],
    private readonly aspect: () => number,
  ) {
    this.#field = new SeenField(seen);
    this.floor = Math.min(FLOOR, OF_PHOTOS * usual(this.#field, cameras, aspect()));
  }

  /** The view that a gesture leads to, or as much of it as keeps what is shown covered; it moves softly up to there. */
  bounded(gesture: Gesture): LookAt {
    const [from, goal] = [gesture(0), gesture(1)];
    if (this.floor <= 0) return goal;
    const after = this.#of(goal);
    if (after >= this.floor + SOFT) return goal;
    const before = this.#of(from);
    if (after >= before) return goal;
    const room = Math.max(0, Math.min(1, (after - this.floor) / SOFT));
    for (let [step, share] = [0, Math.max(LEAST, room)]; step < STEPS; step++, share /= 2) {
      const view = gesture(share);
      if (this.#of(view) >= Math.min(this.floor, before)) return view;
    }
    return from;
  }

  /** The last view of a gesture that is covered; the one that it began with, where none is. */
  farthest(gesture: Gesture): LookAt {
    const shares = Array.from({ length: SHARES }, (_, back) => 1 - back / SHARES);
    return gesture(shares.find((share) => this.shows(gesture(share))) ?? 0);
  }

  /** Whether enough of a picture was seen. */
  shows(view: LookAt): boolean {
    return this.#of(view) >= this.floor;
  }

  /** Whether no photo shows what a picture does, or hardly anything of it. */
  showsNothing(view: LookAt): boolean {
    return this.floor > 0 && this.#of(view) < NOTHING * this.floor;
  }

  #of(view: LookAt): number {
    return this.#field.coverage(view, this.aspect());
  }
}

/** The median coverage of views from where the photos were taken; 0 without any. */
function usual(field: SeenField, cameras: readonly PosedCamera[], aspect: number): number {
  if (cameras.length === 0) return 0;
  const middle = centerOfAttention(cameras);
  const step = Math.max(1, Math.floor(cameras.length / 16));
  const each = cameras
    .filter((_, at) => at % step === 0)
    .map((camera) => {
      const { position, forward, up } = rayOf(camera);
      const depth = Math.max(0.1, dot(subtract(middle, position), forward));
      return field.coverage({ position, target: add(position, scale(forward, depth)), up }, aspect);
    })
    .sort((one, other) => one - other);
  return each[each.length >> 1] ?? 0;
}
