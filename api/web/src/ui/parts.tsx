import type { ComponentChildren } from "preact";

import { ApiError } from "../api/http";
import { texts } from "../texts";

/** What went wrong, in the server's words: the sentence, the limit, and what to do. */
export function ErrorNote({ error, onRetry }: { error: unknown; onRetry?: () => void }) {
  const message = error instanceof Error ? error.message : texts.errors.failed;
  return (
    <div class="note error" role="alert">
      <p>{sentence(message)}</p>
      {error instanceof ApiError && error.limit && <p>{texts.limit(error.limit)}</p>}
      {error instanceof ApiError && error.hint && <p class="hint">{error.hint}</p>}
      {onRetry && (
        <button type="button" onClick={onRetry}>
          {texts.tryAgain}
        </button>
      )}
    </div>
  );
}

export function Loading({ children = texts.loading }: { children?: ComponentChildren }) {
  return (
    <p class="loading" role="status">
      {children}
    </p>
  );
}

/** A message of the server begins with a small letter and has no full stop: it is one clause of a longer line elsewhere. */
export function sentence(text: string): string {
  const trimmed = text.trim();
  if (!trimmed) return trimmed;
  const begun = trimmed.charAt(0).toUpperCase() + trimmed.slice(1);
  return /[.!?]$/.test(begun) ? begun : `${begun}.`;
}
