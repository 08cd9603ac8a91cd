"""The one table from `Kind` to HTTP and gRPC statuses, and the two ways of saying the same problem.

HTTP: RFC 9457 `application/problem+json`. gRPC: `google.rpc.Status` with one `google.rpc.ErrorInfo` in the trailing
metadata `grpc-status-details-bin` (AIP-193).
"""

from __future__ import annotations

import logging
import re
import uuid
from dataclasses import dataclass

import grpc
from google.protobuf import any_pb2, duration_pb2
from google.rpc import code_pb2, error_details_pb2, status_pb2  # type: ignore[import-untyped]

from fastsplat.service.common.errors import FastSplatError, Kind

DOMAIN = "fastsplat"
"""The `domain` of every ErrorInfo."""

_log = logging.getLogger(__name__)
_REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")
_MAX_CHARS = 1_000  # gRPC's metadata stop at 8 KiB, and a 100 kB question need not be read back to the one who asked it


@dataclass(frozen=True)
class Status:
    """One row of the table.

    Attributes:
        http: status code of the HTTP response.
        grpc: status code of the RPC.
        title: the problem's title, the same for every occurrence.
    """

    http: int
    grpc: grpc.StatusCode
    title: str


_BY_KIND = {
    Kind.INVALID_ARGUMENT: Status(400, grpc.StatusCode.INVALID_ARGUMENT, "The request is malformed"),
    Kind.NOT_FOUND: Status(404, grpc.StatusCode.NOT_FOUND, "There is nothing of that name"),
    Kind.ALREADY_EXISTS: Status(409, grpc.StatusCode.ALREADY_EXISTS, "This conflicts with something that exists"),
    Kind.FAILED_PRECONDITION: Status(409, grpc.StatusCode.FAILED_PRECONDITION, "This cannot be done in this state"),
    Kind.RESOURCE_EXHAUSTED: Status(503, grpc.StatusCode.RESOURCE_EXHAUSTED, "The server is out of a resource"),
    Kind.UNAUTHENTICATED: Status(401, grpc.StatusCode.UNAUTHENTICATED, "A key is needed"),
    Kind.PERMISSION_DENIED: Status(403, grpc.StatusCode.PERMISSION_DENIED, "The key does not allow this"),
    Kind.CANCELLED: Status(499, grpc.StatusCode.CANCELLED, "The request was cancelled"),
    Kind.UNAVAILABLE: Status(503, grpc.StatusCode.UNAVAILABLE, "The service is not available now"),
    Kind.INTERNAL: Status(500, grpc.StatusCode.INTERNAL, "The server failed"),
}
_BY_REASON = {
    # One gRPC code, two HTTP ones: this request is too large, whoever sends it and whenever.
    "LIMIT_EXCEEDED": Status(413, grpc.StatusCode.RESOURCE_EXHAUSTED, "The request passes a limit"),
    "RATE_LIMITED": Status(429, grpc.StatusCode.RESOURCE_EXHAUSTED, "Too many requests"),
    # Not 429: who waits and sends it again gets the same answer.
    "QUOTA": Status(403, grpc.StatusCode.RESOURCE_EXHAUSTED, "The key's quota is used up"),
    "UPLOAD_LOCKED": Status(423, grpc.StatusCode.FAILED_PRECONDITION, "Somebody else is at it"),
    "CHECKSUM_MISMATCH": Status(460, grpc.StatusCode.INVALID_ARGUMENT, "The checksum does not fit"),
    "TUS_VERSION": Status(412, grpc.StatusCode.FAILED_PRECONDITION, "The protocol's version is not spoken here"),
    "UNSUPPORTED_MEDIA_TYPE": Status(415, grpc.StatusCode.INVALID_ARGUMENT, "The body has another type"),
    "RANGE_NOT_SATISFIABLE": Status(416, grpc.StatusCode.OUT_OF_RANGE, "The range lies outside the file"),
    "METHOD_NOT_ALLOWED": Status(405, grpc.StatusCode.UNIMPLEMENTED, "The path does not know this method"),
}


@dataclass(frozen=True)
class Problem:
    """What both protocols say about one error.

    Attributes:
        status: HTTP and gRPC codes and the title.
        reason: UPPER_SNAKE_CASE, stable across releases.
        detail: one sentence on this occurrence.
        details: any of field, limit and hint.
        request_id: finds the request in the server's log.
        retry_after_s: seconds after which it may be sent again, if that is known.
    """

    status: Status
    reason: str
    detail: str
    details: dict[str, str]
    request_id: str
    retry_after_s: float | None = None

    def as_json(self) -> dict[str, str | int]:
        """The members of a problem+json object."""
        return {
            "type": f"urn:{DOMAIN}:problem:{self.reason.lower().replace('_', '-')}",
            "title": self.status.title,
            "status": self.status.http,
            "detail": self.detail,
            "reason": self.reason,
            **self.details,
            "request_id": self.request_id,
        }

    def as_rpc_status(self) -> status_pb2.Status:
        """The same as google.rpc.Status with an ErrorInfo, and a RetryInfo where the time is known."""
        info = error_details_pb2.ErrorInfo(
            reason=self.reason, domain=DOMAIN, metadata={**self.details, "request_id": self.request_id}
        )
        details = [info]
        if self.retry_after_s is not None:
            delay = duration_pb2.Duration()
            delay.FromNanoseconds(int(self.retry_after_s * 1e9))
            details.append(error_details_pb2.RetryInfo(retry_delay=delay))
        packed = [any_pb2.Any() for _ in details]
        for into, detail in zip(packed, details, strict=True):
            into.Pack(detail)
        code = code_pb2.Code.Value(self.status.grpc.name)
        return status_pb2.Status(code=code, message=self.detail, details=packed)


def status_of(error: FastSplatError) -> Status:
    """The table's row for `error`."""
    return _BY_REASON.get(error.reason) or _BY_KIND[error.kind]


def problem_of(error: Exception, request_id: str) -> Problem:
    """Describe any exception; one that is not ours is logged with its traceback and reveals nothing of itself."""
    if isinstance(error, FastSplatError):
        if error.kind is Kind.INTERNAL:
            _log.error("request %s failed: %s", request_id, error, exc_info=error)
        details = {name: _shortened(value) for name, value in error.details().items()}
        return Problem(
            status_of(error), error.reason, _shortened(error.message), details, request_id, error.retry_after_s
        )
    _log.error("request %s failed unexpectedly", request_id, exc_info=error)
    return Problem(
        _BY_KIND[Kind.INTERNAL],
        "INTERNAL",
        "The server failed unexpectedly; its log has the cause under this request id.",
        {"hint": "Try again; if it stays, report it with the request id."},
        request_id,
    )


def accepted_request_id(proposed: str) -> str:
    """The caller's id if it is short and plain (it goes into logs), else a new one."""
    return proposed if _REQUEST_ID.fullmatch(proposed) else uuid.uuid4().hex


def _shortened(text: str) -> str:
    text = text.encode(errors="replace").decode()  # a lone surrogate of the request fits in no answer
    return text if len(text) <= _MAX_CHARS else f"{text[: _MAX_CHARS - 1]}…"
