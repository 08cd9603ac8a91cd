import type { PosedCamera } from "../api/types";
import type { LookAt } from "./poses";
import { axesOf, focalLength, rayOf } from "./poses";
import type { SplatColumns } from "./spz";
import type { Grid, GridCamera, Surfaces } from "./surfaceGrid";
import { cellOf, gridOf, surfacesOf } from "./surfaceGrid";
import type { Vec } from "./vectors";
import { cross, scale } from "./vectors";

const MOST_CAMERAS = 64;
const COLUMNS = 32; // of the pictures that are counted in
const ENOUGH = 2; // photos
const ALIKE = Math.cos(Math.PI / 4); // between the direction of a photo and one in which a surface looks the same
const NEAREST = 0.3; // of a photo's distance: nearer, a surface is blurred
const BEHIND = 0.04; // of the depth, by which a surface may lie behind the nearest and still be seen

/** From where the scene's surfaces were seen: for each of a sample, the photos that show it and their directions. */
export class SeenField {
  readonly #surfaces: Surfaces;
  readonly #cameras: readonly GridCamera[];
  /** Of each sample: where its sightings begin; x, y, z of a unit vector to the photo, and the distance. */
  readonly #starts: Uint32Array;
  readonly #sightings: Float32Array;

  constructor(splat: SplatColumns, cameras: readonly PosedCamera[]) {
    const step = Math.max(1, cameras.length / MOST_CAMERAS);
    const chosen = Array.from({ length: Math.floor(cameras.length / step) }, (_, at) => cameras[Math.floor(at * step)]);
    this.#cameras = chosen.flatMap((camera) => (camera ? [gridCameraOf(camera)] : []));
    this.#surfaces = surfacesOf(splat);
    const grids = this.#cameras.map((camera) => gridOf(this.#surfaces, camera));
    this.#starts = new Uint32Array(this.#surfaces.count + 1);
    const sightings: number[] = [];
    for (let sample = 0; sample < this.#surfaces.count; sample++) {
      this.#cameras.forEach((camera, at) => {
        const grid = grids[at];
        if (grid && this.#isSeen(sample, camera, grid)) sightings.push(...this.#towards(sample, camera.position));
      });
      this.#starts[sample + 1] = sightings.length / 4;
    }
    this.#sightings = Float32Array.from(sightings);
  }

  /** How much of a picture shows surfaces that two photos show from about there: 0..1. */
  coverage(view: LookAt, aspect: number): number {
    const camera = gridCameraOfView(view, aspect);
    const { nearest } = gridOf(this.#surfaces, camera);
    let seen = 0;
    for (const sample of nearest) if (sample >= 0 && this.#isKnown(sample, view.position)) seen += 1;
    return seen / nearest.length;
  }

  #isSeen(sample: number, camera: GridCamera, { depths }: Grid): boolean {
    const at = cellOf(this.#surfaces, sample, camera);
    if (!at) return false;
    const front = depths[at.row * camera.width + at.column] ?? 0;
    return at.depth <= front * (1 + BEHIND) + (this.#surfaces.radii[sample] ?? 0);
  }

  #isKnown(sample: number, from: Vec): boolean {
    const [x, y, z, distance] = this.#towards(sample, from);
    const enough = Math.min(ENOUGH, this.#cameras.length);
    let photos = 0;
    const end = this.#starts[sample + 1] ?? 0;
    for (let at = this.#starts[sample] ?? 0; at < end && photos < enough; at++) {
      const [a = 0, b = 0, c = 0, far = 0] = this.#sightings.subarray(4 * at, 4 * at + 4);
      if (a * x + b * y + c * z >= ALIKE && distance >= NEAREST * far) photos += 1;
    }
    return photos >= enough;
  }

  #towards(sample: number, from: Vec): [number, number, number, number] {
    const { positions } = this.#surfaces;
    const x = from[0] - (positions[3 * sample] ?? 0);
    const y = from[1] - (positions[3 * sample + 1] ?? 0);
    const z = from[2] - (positions[3 * sample + 2] ?? 0);
    const distance = Math.hypot(x, y, z) || 1;
    return [x / distance, y / distance, z / distance, distance];
  }
}

function gridCameraOf(camera: PosedCamera): GridCamera {
  const { position, forward, up } = rayOf(camera);
  const { width, height, fx, fy, cx, cy } = camera.intrinsics;
  const [columns, rows] = [COLUMNS, Math.max(1, Math.round((COLUMNS * height) / width))];
  const [across, along] = [columns / width, rows / height];
  return {
    ...{ position, forward, right: cross(forward, up), down: scale(up, -1), width: columns, height: rows },
    ...{ fx: fx * across, fy: fy * along, cx: cx * across, cy: cy * along },
  };
}

/** @param aspect width by height of the picture. */
function gridCameraOfView(view: LookAt, aspect: number): GridCamera {
  const { right, down, forward } = axesOf(view);
  const [width, height] = [COLUMNS, Math.max(1, Math.round(COLUMNS / aspect))];
  const focal = focalLength(width, height, view.fieldOfView);
  const camera = { position: view.position, right, down, forward, width, height };
  return { ...camera, fx: focal, fy: focal, cx: width / 2, cy: height / 2 };
}
