import { signal } from "@preact/signals";

import type { Route, SceneAddress } from "./addresses";
import { isPlace, parseRoute, sceneAddress as addressOf, shareKeyIn } from "./addresses";
import { shareKey } from "./share";
import { takeUploadKey } from "./uploadLink";

takeUploadKey();

/** See `addresses.ts`; on a page that a link has opened, its addresses go on with the link's key. */
export function sceneAddress(sceneId: string, more: SceneAddress = {}): string {
  return addressOf(sceneId, { ...more, share: shareKey });
}

/** The page's address, as it is now. */
export const route = signal<Route>(parseRoute(location.hash));

// The address that `route` is of. The browser tells of a new one only later: until then `location` is ahead of it.
let known = location.hash;

window.addEventListener("hashchange", () => {
  if (isPlace(location.hash)) {
    history.replaceState(null, "", known || "#/"); // the browser has gone there; the page stays what it is
    return;
  }
  const other = shareKeyIn(location.hash);
  if (other && other !== shareKey) location.reload(); // another link, another caller
  takeUploadKey();
  known = location.hash;
  route.value = parseRoute(known);
});

export function go(address: string): void {
  location.hash = address;
}

/** Corrects the address without a history entry, e.g. while the camera moves; not if it changed meanwhile. */
export function replaceAddress(address: string): void {
  if (location.hash !== known) return;
  history.replaceState(null, "", address);
  known = location.hash;
}
