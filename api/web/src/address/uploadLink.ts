import { signal } from "@preact/signals";

/** The page that a link for one upload opens. */
const PHONE = "#/phone";
const STORED_KEY = "fastsplat-upload-key";

/** The key of this tab's link for one upload; it opens nothing else, and is not the browser's own. */
export const uploadKey = signal(sessionStorage.getItem(STORED_KEY) ?? "");

/** Whether the server took the link's key. */
export const linkRefused = signal(false);

/** Takes the key out of the address behind #, so that it stays in no history and in no bookmark. */
export function takeUploadKey(): void {
  const match = /^#\/phone\?key=([\w-]+)$/.exec(location.hash);
  if (!match?.[1]) return;
  sessionStorage.setItem(STORED_KEY, match[1]);
  uploadKey.value = match[1];
  linkRefused.value = false;
  history.replaceState(null, "", PHONE);
}

/** Whether the page is open for one upload; then it asks with the link's key. */
export function isPhone(): boolean {
  return location.hash === PHONE;
}

/** The address of a link; everything behind # stays in the browser, and so reaches no log. */
export function linkFor(page: string, secret: string): string {
  return `${page.replace(/[#?].*$/, "").replace(/\/*$/, "/")}${PHONE}?key=${secret}`;
}

/** Whether only this machine can reach a host name. */
export function isLoopback(host: string): boolean {
  return host === "localhost" || host === "[::1]" || host.endsWith(".localhost") || /^127\./.test(host);
}
