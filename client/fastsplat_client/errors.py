"""What the server refuses, as the exception it raised there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from fastsplat.service.common.errors import FastSplatError, Kind


class RemoteError(FastSplatError):
    """The server says something that this client has no exception for; its `kind` and `reason` are the server's."""


class UnreachableError(FastSplatError):
    """No connection, or one that broke before the answer was whole."""

    kind = Kind.UNAVAILABLE
    reason = "UNREACHABLE"


class DeadlineExceededError(FastSplatError):
    """The answer did not come in the time that the caller gave; the server stops working on it."""

    kind = Kind.CANCELLED
    reason = "DEADLINE_EXCEEDED"


def error_of(
    reason: str, kind: Kind, message: str, details: Mapping[str, str], retry_after_s: float | None = None
) -> FastSplatError:
    """The exception of that reason, with the server's own words and the request's id as a note.

    Args:
        reason: UPPER_SNAKE_CASE, as in problem+json and ErrorInfo.
        kind: for a reason that is not known here.
        message: one sentence.
        details: any of field, limit, hint and request_id.
        retry_after_s: when the server said so.
    """
    raised: type[FastSplatError] = next(
        (found for found in _tree(FastSplatError) if found.reason == reason),
        type("RemoteError", (RemoteError,), {"kind": kind, "reason": reason}),
    )
    error = raised(message, **{name: details.get(name) or "" for name in ("field", "limit", "hint")})
    error.retry_after_s = retry_after_s
    if details.get("request_id"):
        error.add_note(f"request id {details['request_id']}")
    return error


def _tree(root: type[FastSplatError]) -> Iterator[type[FastSplatError]]:
    """The errors that every part of the product knows; those of single rooms stay with them."""
    if root.__module__ == FastSplatError.__module__:
        yield root
    for kind in root.__subclasses__():
        yield from _tree(kind)
