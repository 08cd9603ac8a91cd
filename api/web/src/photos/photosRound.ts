import type { Operation } from "../api/types";

/** Changes when the capture stage of a job is done: then its photos have been looked at. */
export function photosRound(operation: Operation | null): string {
  if (!operation) return "";
  const capture = operation.stages.find((stage) => stage.stage === "capture");
  const later = operation.stages.some((stage) => stage.stage !== "capture");
  return `${operation.id} ${operation.state} ${later || (capture?.fraction ?? 0) >= 1 ? "looked" : "before"}`;
}
