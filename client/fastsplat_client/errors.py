"""Errors of the server, raised in the client as the same exceptions."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import TypeVar

import httpx

from fastsplat_contract.codec.json_codec import from_json
from fastsplat_contract.errors import FastSplatError, InvalidInputError, Kind

T = TypeVar("T")

_KINDS = {
    401: Kind.UNAUTHENTICATED,
    403: Kind.PERMISSION_DENIED,
    404: Kind.NOT_FOUND,
    409: Kind.FAILED_PRECONDITION,
    413: Kind.RESOURCE_EXHAUSTED,
    429: Kind.RESOURCE_EXHAUSTED,
    502: Kind.UNAVAILABLE,
    503: Kind.UNAVAILABLE,
    504: Kind.UNAVAILABLE,
}


class RemoteError(FastSplatError):
    """An error of the server that this client has no exception for; its `kind` and `reason` are the server's."""


class UnreachableError(FastSplatError):
    """No connection, or one that broke before the answer was whole."""

    kind = Kind.UNAVAILABLE
    reason = "UNREACHABLE"


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


def problem_of(content: str | bytes, status: int = 0, after: str = "") -> FastSplatError:
    """What a problem document (RFC 9457) says, as the exception that the server raised.

    Args:
        content: the document, or whatever else the server sent.
        status: of the answer; 0: what the document says.
        after: the header Retry-After, "" without.
    """
    try:
        body = json.loads(content)
        reason, detail, status = str(body["reason"]), str(body["detail"]), status or int(body["status"])
    except (ValueError, KeyError, TypeError, RecursionError):
        body, reason, detail = {}, "", f"HTTP {status} without a problem to read"
    kind = _KINDS.get(status) or (Kind.INVALID_ARGUMENT if 400 <= status < 500 else Kind.INTERNAL)
    return error_of(reason, kind, detail, body, seconds_after(after))


def seconds_after(header: str) -> float | None:
    """What a Retry-After header says, if it says seconds; one that says a date, or "", says nothing."""
    return float(header) if re.fullmatch(r"[0-9]{1,9}(\.[0-9]{1,9})?", header) else None


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
