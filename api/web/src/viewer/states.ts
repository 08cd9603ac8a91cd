/** What is shown of each Gaussian beside its own color. A higher one wins. */
export const PLAIN = 0;
export const FOUND = 1;
export const HOVERED = 2;
export const SELECTED = 3;
const HIDDEN = 4;

/** bool [count] as bytes 0 and 1 of packed bits, most significant bit first: the contract's mask encoding "bits". */
export function unpackBits(bits: Uint8Array, count: number): Uint8Array {
  const mask = new Uint8Array(count);
  for (let row = 0; row < count; row++) mask[row] = ((bits[row >> 3] ?? 0) >> (7 - (row & 7))) & 1;
  return mask;
}

/** The bytes of base64 text. */
export function fromBase64(text: string): Uint8Array<ArrayBuffer> {
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}

/**
 * The state of each Gaussian.
 *
 * @param count how many Gaussians there are.
 * @param found bytes [count], 1 where it answers the question; null without a question.
 * @param objects uint16 [count], which object it belongs to; null while unknown.
 * @param hovered,selected ids of objects; 0 for none.
 * @param shows whether the Gaussians of an object (0: of none) are shown.
 * @param part bytes [count], 1 where a part is that is selected; null for none.
 * @param going bytes [count], 1 for what is not shown because it would go; null for none.
 */
export function statesOf(
  count: number,
  found: Uint8Array | null,
  objects: Uint16Array | null,
  hovered: number,
  selected: readonly number[],
  shows: (object: number) => boolean = () => true,
  part: Uint8Array | null = null,
  going: Uint8Array | null = null,
): Uint8Array {
  const states = new Uint8Array(count);
  const chosen = new Set(selected);
  const shown = new Map<number, boolean>();
  for (let row = 0; row < count; row++) {
    const object = objects?.[row] ?? 0;
    if (!shown.has(object)) shown.set(object, shows(object));
    if (!shown.get(object) || going?.[row]) states[row] = HIDDEN;
    else if ((object && chosen.has(object)) || part?.[row]) states[row] = SELECTED;
    else if (object && object === hovered) states[row] = HOVERED;
    else if (found?.[row]) states[row] = FOUND;
  }
  return states;
}
