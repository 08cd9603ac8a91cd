export const SMALLEST = 0.25;

/**
 * The next picture's scale while the camera moves: half the pixels if the last was slow, twice if surely quick enough.
 *
 * @param scale of the last picture, 0..1.
 * @param milliseconds that it took.
 * @param most milliseconds that a picture may take.
 */
export function nextScale(scale: number, milliseconds: number, most: number): number {
  if (milliseconds > most) return Math.max(SMALLEST, scale * Math.SQRT1_2);
  return milliseconds < most / 2 ? Math.min(1, scale * Math.SQRT2) : scale;
}

/** Width and height of a picture of at most `pixels` pixels for a place of the given size, each at least 1. */
export function pictureSize(width: number, height: number, scale: number, pixels: number): [number, number] {
  const ratio = scale * Math.min(1, Math.sqrt(pixels / Math.max(1, width * height)));
  return [Math.max(1, Math.round(width * ratio)), Math.max(1, Math.round(height * ratio))];
}
