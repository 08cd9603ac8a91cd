"""Conversion of server errors to the contract's exceptions."""

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
    """A server error unknown to this client; `kind` and `reason` are the server's."""


class UnreachableError(FastSplatError, kind=Kind.UNAVAILABLE, reason="UNREACHABLE"):
    """The connection failed or broke before the answer was complete."""


def read(kind: type[T], answer: httpx.Response | str) -> T:
    """Decodes an answer. Raises `RemoteError` if it is unreadable, e.g. from an incompatible release."""
    try:
        return from_json(kind, answer if isinstance(answer, str) else answer.content)
    except InvalidInputError as error:
        raise RemoteError(
            f"the server's answer cannot be read: {error.message}",
            field=error.field,
            hint="Is it a FAST-Splat server, and of this client's release?",
        ) from error


def problem_of(content: str | bytes, status: int = 0, after: str = "") -> FastSplatError:
    """Converts a problem document (RFC 9457), or any other error body, to an exception.

    `status` 0 means the document's; `after` is the Retry-After header.
    """
    try:
        body = json.loads(content)
        reason, detail, status = str(body["reason"]), str(body["detail"]), status or int(body["status"])
    except (ValueError, KeyError, TypeError, RecursionError):
        body, reason, detail = {}, "", f"HTTP {status} without a problem to read"
    kind = _KINDS.get(status) or (Kind.INVALID_ARGUMENT if 400 <= status < 500 else Kind.INTERNAL)
    return error_of(reason, kind, detail, body, seconds_after(after))


def seconds_after(header: str) -> float | None:
    """Parses a Retry-After header in seconds; None for a date or ""."""
    return float(header) if re.fullmatch(r"[0-9]{1,9}(\.[0-9]{1,9})?", header) else None


def error_of(
    reason: str, kind: Kind, message: str, details: Mapping[str, str], retry_after_s: float | None = None
) -> FastSplatError:
    """Builds the exception of a reason, or a `RemoteError` of `kind` for an unknown one.

    `details` may have field, limit, hint and request_id, which is added as a note.
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
    """Yields the contract's error classes, without those that other modules define."""
    if root.__module__ == FastSplatError.__module__:
        yield root
    for kind in root.__subclasses__():
        yield from _tree(kind)
