const SLOW_MS = 110; // nine pictures a second
const SMALLEST = 0.25;

/**
 * The sides of the next picture while the camera moves, as a share of the full ones: half of it where the last one took
 * too long, twice where that is sure to be quick enough. A picture of twice the sides takes at most four times as long.
 *
 * @param scale of the last picture, 0..1.
 * @param milliseconds from its request to its pixels.
 */
export function nextScale(scale: number, milliseconds: number): number {
  if (milliseconds > SLOW_MS) return Math.max(SMALLEST, scale / 2);
  return milliseconds < SLOW_MS / 4 ? Math.min(1, scale * 2) : scale;
}

/** Width and height of a picture of at most `pixels` pixels for a place of the given size, each at least 1. */
export function pictureSize(width: number, height: number, scale: number, pixels: number): [number, number] {
  const ratio = scale * Math.min(1, Math.sqrt(pixels / Math.max(1, width * height)));
  return [Math.max(1, Math.round(width * ratio)), Math.max(1, Math.round(height * ratio))];
}
