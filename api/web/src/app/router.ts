import { signal } from "@preact/signals";

import type { Route, SceneAddress } from "./addresses";
import { parseRoute, sceneAddress as addressOf, shareKeyIn } from "./addresses";
import { shareKey } from "./share";
import { takeUploadKey } from "./uploadLink";

takeUploadKey();

/** See `addresses.ts`; on a page that a link has opened, its addresses go on with the link's key. */
export function sceneAddress(sceneId: string, more: SceneAddress = {}): string {
  return addressOf(sceneId, { ...more, share: shareKey });
}

/** The page's address, as it is now. */
export const route = signal<Route>(parseRoute(location.hash));

window.addEventListener("hashchange", () => {
  const other = shareKeyIn(location.hash);
  if (other && other !== shareKey) location.reload(); // another link, another caller
  takeUploadKey();
  route.value = parseRoute(location.hash);
});

export function go(address: string): void {
  location.hash = address;
}

/** Puts the address right without a new entry in the history, e.g. while the camera moves. */
export function replaceAddress(address: string): void {
  history.replaceState(null, "", address);
}
