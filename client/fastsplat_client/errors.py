"""What the server refuses, as the exception it raised there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TypeVar

import httpx

from fastsplat_contract.errors import FastSplatError, InvalidInputError, Kind
from fastsplat_contract.json_codec import from_json

T = TypeVar("T")


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


def read(kind: type[T], answer: httpx.Response | str) -> T:
    """What the server answered.

    Raises:
        RemoteError: it cannot be read, as from a server of another release.
    """
    try:
        return from_json(kind, answer if isinstance(answer, str) else answer.content)
    except InvalidInputError as error:
        raise RemoteError(
            f"the server's answer cannot be read: {error.message}",
            field=error.field,
            hint="Is it a FAST-Splat server, and of this client's release?",
        ) from error


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
        (known for known in _tree(FastSplatError) if known.reason == reason),
        type("RemoteError", (RemoteError,), {"kind": kind, "reason": reason}),
    )
    error = raised(message, **{name: details.get(name) or "" for name in ("field", "limit", "hint")})
    error.retry_after_s = retry_after_s
    if request_id := details.get("request_id"):
        error.request_id = request_id
        if hasattr(error, "add_note"):  # Python 3.11 and later
            error.add_note(f"request id {request_id}")
    return error


def _tree(root: type[FastSplatError]) -> Iterator[type[FastSplatError]]:
    """The errors of the contract; others may be defined beside it."""
    if root.__module__ == FastSplatError.__module__:
        yield root
    for kind in root.__subclasses__():
        yield from _tree(kind)
