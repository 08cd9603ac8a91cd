"""What the server refuses, as the exception it raised there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from service.common.errors import FastSplatError, Kind


class RemoteError(FastSplatError):
    """The server says something that this release of the client has no exception for; `reason` is its own."""

    def __init__(self, message: str, *, hint: str = "", field: str = "", limit: str = "", reason: str = "") -> None:
        super().__init__(message, hint=hint, field=field, limit=limit)
        self.remote_reason = reason


class UnreachableError(FastSplatError):
    """No connection, or one that broke before the answer was whole."""

    kind = Kind.UNAVAILABLE
    reason = "UNREACHABLE"


class DeadlineExceededError(FastSplatError):
    """The answer did not come in the time that the caller gave; the server stops working on it."""

    kind = Kind.CANCELLED
    reason = "DEADLINE_EXCEEDED"


def error_of(
    reason: str, message: str, details: Mapping[str, str], retry_after_s: float | None = None
) -> FastSplatError:
    """The exception of that reason, with the server's own words and the request's id as a note.

    Args:
        reason: UPPER_SNAKE_CASE, as in problem+json and ErrorInfo.
        message: one sentence.
        details: any of field, limit, hint and request_id.
        retry_after_s: when the server said so.
    """
    words = {name: details.get(name) or "" for name in ("field", "limit", "hint")}
    known = next((kind for kind in _tree(FastSplatError) if kind.reason == reason), None)
    error = RemoteError(message, **words, reason=reason) if known is None else known(message, **words)
    error.retry_after_s = retry_after_s
    if details.get("request_id"):
        error.add_note(f"request id {details['request_id']}")
    return error


def _tree(root: type[FastSplatError]) -> Iterator[type[FastSplatError]]:
    if "reason" in vars(root):  # one that inherits its reason is a refinement that the wire does not tell apart
        yield root
    for kind in root.__subclasses__():
        yield from _tree(kind)
