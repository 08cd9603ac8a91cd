import type { PosedCamera } from "../api/types";
import type { LookAt } from "./poses";
import { axesOf, focalLength, rayOf } from "./poses";
import type { SplatColumns } from "./spz";
import type { Fog, Grid, GridCamera, Surfaces } from "./surfaceGrid";
import { cellOf, fogOf, gridOf, hazeOf, surfacesOf } from "./surfaceGrid";
import type { Vec } from "./vectors";
import { cross, scale } from "./vectors";

const MOST_CAMERAS = 64;
const COLUMNS = 32; // of the pictures that are counted in
const ENOUGH = 2; // photos
const ALIKE = Math.cos(Math.PI / 4); // between the direction of a photo and one in which a surface looks the same
const NEAREST = 0.3; // of a photo's distance: nearer, a surface is blurred
const HAZY = 0.2; // −log of the share of the light that fog must let through
const BEHIND = 0.04; // of the depth, by which a surface may lie behind the nearest and still be seen

/** What photos saw of a scene: data alone, that a worker can send. */
export interface Sightings {
  surfaces: Surfaces;
  /** What may hide them from where no photo was taken. */
  fog: Fog;
  photos: number;
  /** Of each sample of the surfaces: where its sightings begin; x, y, z of a unit vector to the photo, and the distance. */
  starts: Uint32Array;
  sightings: Float32Array;
}

/** Which photos show each of a sample of the surfaces: some tenths of a second of work. */
export function sightingsOf(splat: SplatColumns, cameras: readonly PosedCamera[]): Sightings {
  const step = Math.max(1, cameras.length / MOST_CAMERAS);
  const chosen = Array.from({ length: Math.floor(cameras.length / step) }, (_, at) => cameras[Math.floor(at * step)]);
  const photos = chosen.flatMap((camera) => (camera ? [gridCameraOf(camera)] : []));
  const surfaces = surfacesOf(splat);
  const grids = photos.map((photo) => gridOf(surfaces, photo));
  const starts = new Uint32Array(surfaces.count + 1);
  const sightings: number[] = [];
  for (let sample = 0; sample < surfaces.count; sample++) {
    photos.forEach((photo, at) => {
      const grid = grids[at];
      if (grid && isSeen(surfaces, sample, photo, grid)) sightings.push(...towards(surfaces, sample, photo.position));
    });
    starts[sample + 1] = sightings.length / 4;
  }
  return { surfaces, fog: fogOf(splat), photos: photos.length, starts, sightings: Float32Array.from(sightings) };
}

/** From where the scene's surfaces were seen. */
export class SeenField {
  constructor(private readonly seen: Sightings) {}

  /** How much of a picture shows surfaces that two photos show from about there: 0..1. */
  coverage(view: LookAt, aspect: number): number {
    const camera = gridCameraOfView(view, aspect);
    const grid = gridOf(this.seen.surfaces, camera);
    const haze = hazeOf(this.seen.fog, camera, grid);
    const seen = grid.nearest.filter(
      (sample, cell) => sample >= 0 && (haze[cell] ?? 0) <= HAZY && this.#isKnown(sample, view.position),
    );
    return seen.length / grid.nearest.length;
  }

  #isKnown(sample: number, from: Vec): boolean {
    const { surfaces, starts, sightings } = this.seen;
    const [x, y, z, distance] = towards(surfaces, sample, from);
    const enough = Math.min(ENOUGH, this.seen.photos);
    let photos = 0;
    const end = starts[sample + 1] ?? 0;
    for (let at = starts[sample] ?? 0; at < end && photos < enough; at++) {
      const along = x * (sightings[4 * at] ?? 0) + y * (sightings[4 * at + 1] ?? 0) + z * (sightings[4 * at + 2] ?? 0);
      if (along >= ALIKE && distance >= NEAREST * (sightings[4 * at + 3] ?? 0)) photos += 1;
    }
    return photos >= enough;
  }
}

function isSeen(surfaces: Surfaces, sample: number, photo: GridCamera, { depths }: Grid): boolean {
  const at = cellOf(surfaces, sample, photo);
  if (!at || at.column < 0 || at.row < 0 || at.column >= photo.width || at.row >= photo.height) return false;
  const front = depths[at.row * photo.width + at.column] ?? 0;
  return at.depth <= front * (1 + BEHIND) + (surfaces.radii[sample] ?? 0);
}

/** A unit vector from a sample to a place, and how far it is. */
function towards({ positions }: Surfaces, sample: number, from: Vec): [number, number, number, number] {
  const x = from[0] - (positions[3 * sample] ?? 0);
  const y = from[1] - (positions[3 * sample + 1] ?? 0);
  const z = from[2] - (positions[3 * sample + 2] ?? 0);
  const distance = Math.hypot(x, y, z) || 1;
  return [x / distance, y / distance, z / distance, distance];
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
