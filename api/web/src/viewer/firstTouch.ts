const TOUCHES = ["pointermove", "pointerdown", "keydown", "wheel"];

/** Aborted as soon as a person points, scrolls or types, anywhere on the page. */
export function firstTouch(): AbortController {
  const touched = new AbortController();
  const options = { capture: true, passive: true, signal: touched.signal };
  for (const name of TOUCHES) window.addEventListener(name, () => touched.abort(), options);
  return touched;
}
