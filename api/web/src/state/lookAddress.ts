import type { Mode } from "../viewer/colors";
import { MODES } from "../viewer/colors";

/** How the scene is looked at, as far as the address says it. */
export interface Look {
  mode: Mode;
  cameras: boolean;
  /** Name of the camera whose photo is compared with the scene; empty for none. */
  photo: string;
}

const CAMERAS = "cameras";
const PHOTO = "at:";

/** The look as text for an address; empty for the usual one. */
export function lookText({ mode, cameras, photo }: Look): string {
  const parts = [mode === "photo" ? "" : mode, cameras ? CAMERAS : "", photo ? PHOTO + photo : ""];
  return parts.filter(Boolean).join("~");
}

/** The look of an address; what it does not know it leaves out. A camera's name comes last, whatever is in it. */
export function parseLook(text: string): Look {
  const at = text.startsWith(PHOTO) ? 0 : text.indexOf(`~${PHOTO}`) + 1 || -1;
  const photo = at < 0 ? "" : text.slice(at + PHOTO.length);
  const words = (at < 0 ? text : text.slice(0, at)).split("~");
  return { mode: MODES.find((mode) => words.includes(mode)) ?? "photo", cameras: words.includes(CAMERAS), photo };
}
