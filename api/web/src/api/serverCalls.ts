import { getJson, listAll, post, postJson, send } from "./http";
import type {
  AccessKey,
  KeyList,
  KnownName,
  KnownNameList,
  NewKey,
  Operation,
  OperationList,
  Role,
  ServerStatus,
} from "./types";

const PAGE_SIZE = 100;

export function serverStatus(signal?: AbortSignal): Promise<ServerStatus> {
  return getJson<ServerStatus>("v1/server/status", signal);
}

/** How long a job of so many photos takes, seconds. */
interface JobEstimate {
  seconds: number;
  stages: Readonly<Record<string, number>>;
}

/** The estimate for photos of this size, pixels; a preset that is empty is the server's. */
export function estimateJob(
  of: { photos: number; width: number; height: number; preset: string },
  signal: AbortSignal,
): Promise<JobEstimate> {
  const said = Object.entries(of).filter(([, value]) => value !== "" && value !== 0);
  const query = new URLSearchParams(said.map(([name, value]): [string, string] => [name, String(value)]));
  return getJson<JobEstimate>(`v1/estimate?${query}`, signal);
}

/** The newest `count` operations of the project, and whether there are more. */
export async function listOperations(
  count: number,
  signal?: AbortSignal,
): Promise<{ operations: Operation[]; more: boolean }> {
  const operations: Operation[] = [];
  let token = "";
  do {
    const query = new URLSearchParams({ page_size: String(Math.min(count, PAGE_SIZE)), page_token: token });
    const page = await getJson<OperationList>(`v1/operations?${query}`, signal);
    operations.push(...page.operations);
    token = page.next_page_token;
  } while (token && operations.length < count);
  return { operations: operations.slice(0, count), more: token !== "" || operations.length > count };
}

export function listKeys(signal?: AbortSignal): Promise<AccessKey[]> {
  return listAll("v1/keys", (page: KeyList) => page.keys, signal);
}

export function createKey(name: string, role: Role, lifetime_s: number | null): Promise<NewKey> {
  return postJson<NewKey>("v1/keys", { name, role, lifetime_s });
}

export function createUploadKey(): Promise<NewKey> {
  return postJson<NewKey>("v1/upload-keys", {});
}

export async function revokeKey(keyId: string): Promise<void> {
  await post(`v1/keys/${encodeURIComponent(keyId)}:revoke`, {});
}

export function listKnownNames(signal?: AbortSignal): Promise<KnownName[]> {
  return listAll("v1/known-names", (page: KnownNameList) => page.names, signal);
}

export async function deleteKnownName(nameId: string): Promise<void> {
  await send(`v1/known-names/${encodeURIComponent(nameId)}`, { method: "DELETE" });
}
