import { signal } from "@preact/signals";

import type { Route } from "./addresses";
import { parseRoute } from "./addresses";
import { takeUploadKey } from "./uploadLink";

takeUploadKey();

export { sceneAddress } from "./addresses";

/** The page's address, as it is now. */
export const route = signal<Route>(parseRoute(location.hash));

window.addEventListener("hashchange", () => {
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
