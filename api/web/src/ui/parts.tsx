import type { ComponentChildren } from "preact";

import { ApiError } from "../api/http";
import { texts } from "../texts";
import { Button } from "./Button";
import { sentence } from "./sentence";

interface Note {
  error: unknown;
  onRetry?: () => void;
  /** Whether the server's advice is shown; it speaks of calls and commands where the page has a link of its own. */
  advises?: boolean;
}

/** What went wrong, in the server's words: the sentence, the limit, and what to do. */
export function ErrorNote({ error, onRetry, advises = true }: Note) {
  const message = error instanceof Error ? error.message : texts.errors.failed;
  return (
    <div class="note error" role="alert">
      <p>{sentence(message, error instanceof ApiError ? error.field : "")}</p>
      {error instanceof ApiError && error.limit && <p>{texts.limit(error.limit)}</p>}
      {advises && error instanceof ApiError && error.hint && <p class="hint">{error.hint}</p>}
      {onRetry && <Button onClick={onRetry} text={texts.tryAgain} />}
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
