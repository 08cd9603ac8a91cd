import { mayDo } from "../api/roles";
import type { ServerStatus } from "../api/types";
import { texts } from "../texts";

/** What an upload may be, as the server said. */
export interface Limits {
  /** Bytes of one upload. */
  maxBytes: number;
  /** Bytes that the project has room for; null: no bound. */
  bytesLeft: number | null;
  maxImages: number;
}

export function limitsOf(status: ServerStatus): Limits {
  const bytes = status.quotas.find((quota) => quota.kind === "bytes");
  return {
    maxBytes: status.max_upload_bytes,
    bytesLeft: bytes?.limit == null ? null : Math.max(0, bytes.limit - bytes.used),
    maxImages: status.max_images,
  };
}

/** Why the caller can upload nothing now; empty if something. */
export function refusalOf(status: ServerStatus): string {
  if (status.role !== "uploader" && !mayDo(status.role, "editor")) return texts.upload.readOnly;
  const full = status.quotas.find((quota) => quota.limit !== null && quota.used >= quota.limit);
  return full ? texts.quota.full[full.kind] : "";
}
