import { signal } from "@preact/signals";

import { shareKey } from "../address/share";
import { isPhone, linkRefused, uploadKey } from "../address/uploadLink";
import { texts } from "../texts";
import type { Problem } from "./types";

/** A request that the server refused: its typed error, see the contract's `Problem`. */
export class ApiError extends Error {
  readonly status: number;
  readonly reason: string;
  readonly limit: string;
  readonly hint: string;
  readonly field: string;

  constructor(status: number, problem: Partial<Problem>) {
    super(problem.detail ?? texts.errors.unreadable);
    this.status = status;
    this.reason = problem.reason ?? "";
    this.limit = problem.limit ?? "";
    this.hint = problem.hint ?? "";
    this.field = problem.field ?? "";
  }
}

/** The server could not be reached. */
export class OfflineError extends Error {
  constructor() {
    super(texts.errors.offline);
  }
}

/** Whether the last request reached the server. */
export const isOnline = signal(true);

/** Why the person has to sign in: no key, or one that the server refused. */
export const signInReason = signal<"" | "missing" | "refused">("");

const STORED_KEY = "fastsplat-key";

/** The key of this browser; it stays until somebody signs out. */
export const accessKey = signal(localStorage.getItem(STORED_KEY) ?? "");

export function signIn(key: string): void {
  localStorage.setItem(STORED_KEY, key);
  accessKey.value = key;
  signInReason.value = "";
}

export function signOut(): void {
  localStorage.removeItem(STORED_KEY);
  accessKey.value = "";
  signInReason.value = "missing";
}

// Another tab has signed in or out.
window.addEventListener("storage", (event) => {
  if (event.key !== STORED_KEY) return;
  accessKey.value = event.newValue ?? "";
  signInReason.value = event.newValue ? "" : "missing";
});

/** The headers that say who asks. */
export function keyHeaders(): Record<string, string> {
  const key = isPhone() ? uploadKey.value : shareKey || accessKey.value;
  return key ? { Authorization: `Bearer ${key}` } : {};
}

/** Notes that the server does not take this browser's key: the page asks for another one, and sends nothing until then. */
export function refuseKey(): void {
  if (isPhone()) linkRefused.value = true;
  else signInReason.value = shareKey || accessKey.value ? "refused" : "missing";
}

/** The problem of a response that is not a success; a body that is none of ours gives one without details. */
export async function problemOf(response: Response): Promise<ApiError> {
  let problem: Partial<Problem> = {};
  try {
    problem = (await response.json()) as Problem;
  } catch {
    problem = { detail: texts.errors.status(response.status) };
  }
  return new ApiError(response.status, problem);
}

/**
 * The response to a request; `path` is relative to the page, so that it leads through the proxy that shows the page.
 *
 * @throws ApiError the server refused it.
 * @throws OfflineError it did not reach the server.
 */
export async function send(
  path: string,
  options: Omit<RequestInit, "headers"> & { headers?: Record<string, string> } = {},
): Promise<Response> {
  let response: Response;
  try {
    response = await fetch(path, { ...options, headers: { ...keyHeaders(), ...options.headers } });
  } catch (error) {
    if (options.signal?.aborted) throw error;
    isOnline.value = false;
    throw new OfflineError();
  }
  isOnline.value = true;
  if (response.status === 401) refuseKey();
  if (!response.ok) throw await problemOf(response);
  return response;
}

export async function getJson<T>(path: string, signal?: AbortSignal): Promise<T> {
  return (await (await send(path, signal ? { signal } : {})).json()) as T;
}

/** Every row of what the server lists in pages, all of which `query` asks for. */
export async function listAll<T>(
  path: string,
  rows: (page: never) => readonly T[],
  signal?: AbortSignal,
  query: Readonly<Record<string, string>> = {},
): Promise<T[]> {
  const values: T[] = [];
  let token = "";
  do {
    const asked = new URLSearchParams({ page_size: "100", ...query, page_token: token });
    const page = await getJson<{ next_page_token: string }>(`${path}?${asked}`, signal);
    values.push(...rows(page as never));
    token = page.next_page_token;
  } while (token);
  return values;
}

export async function postJson<T>(path: string, body: unknown, signal?: AbortSignal): Promise<T> {
  return (await (await post(path, body, signal)).json()) as T;
}

export async function post(path: string, body: unknown, signal?: AbortSignal): Promise<Response> {
  return send(path, {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify(body),
    ...(signal ? { signal } : {}),
  });
}

/** Whether an error only says that the page itself gave the request up. */
export function isAbort(error: unknown): boolean {
  return error instanceof DOMException && error.name === "AbortError";
}
