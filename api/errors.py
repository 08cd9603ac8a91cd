"""Maps errors to HTTP and gRPC statuses, and describes them in both protocols.

HTTP: RFC 9457 `application/problem+json`. gRPC: `google.rpc.Status` with one `google.rpc.ErrorInfo` in the trailing
metadata `grpc-status-details-bin` (AIP-193).
"""

from __future__ import annotations

import errno
import logging
import re
import uuid
from collections.abc import Mapping
from dataclasses import dataclass

import grpc
from google.protobuf import any_pb2, duration_pb2
from google.rpc import code_pb2, error_details_pb2, status_pb2

from fastsplat_contract import errors
from fastsplat_contract.errors import FastSplatError, Kind
from fastsplat_contract.server.problems import Problem

DOMAIN = "fastsplat"
"""The `domain` of every ErrorInfo."""

_log = logging.getLogger(__name__)
_REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")
_MAX_CHARS = 1_000  # gRPC's metadata are limited to 8 KiB, and answers should not repeat long questions


@dataclass(frozen=True)
class Status:
    """HTTP and gRPC status codes of an error class, with its fixed problem title."""

    http: int
    grpc: grpc.StatusCode
    title: str


_OF_KIND: Mapping[Kind, Status] = {
    Kind.INVALID_ARGUMENT: Status(400, grpc.StatusCode.INVALID_ARGUMENT, "The request is malformed"),
    Kind.NOT_FOUND: Status(404, grpc.StatusCode.NOT_FOUND, "There is nothing of that name"),
    Kind.ALREADY_EXISTS: Status(409, grpc.StatusCode.ALREADY_EXISTS, "This conflicts with something that exists"),
    Kind.FAILED_PRECONDITION: Status(409, grpc.StatusCode.FAILED_PRECONDITION, "This cannot be done in this state"),
    Kind.RESOURCE_EXHAUSTED: Status(503, grpc.StatusCode.RESOURCE_EXHAUSTED, "The server is out of a resource"),
    Kind.CANCELLED: Status(499, grpc.StatusCode.CANCELLED, "The request was cancelled"),
    Kind.DEADLINE_EXCEEDED: Status(504, grpc.StatusCode.DEADLINE_EXCEEDED, "The time is up"),
    Kind.UNAUTHENTICATED: Status(401, grpc.StatusCode.UNAUTHENTICATED, "A key is needed"),
    Kind.PERMISSION_DENIED: Status(403, grpc.StatusCode.PERMISSION_DENIED, "The key does not allow this"),
    Kind.UNAVAILABLE: Status(503, grpc.StatusCode.UNAVAILABLE, "The service is not available now"),
    Kind.INTERNAL: Status(500, grpc.StatusCode.INTERNAL, "The server failed"),
}
_APART: Mapping[type[FastSplatError], Status] = {
    errors.ChecksumMismatchError: Status(460, grpc.StatusCode.INVALID_ARGUMENT, "The checksum does not fit"),
    errors.MethodNotAllowedError: Status(405, grpc.StatusCode.UNIMPLEMENTED, "The path does not know this method"),
    errors.RangeNotSatisfiableError: Status(416, grpc.StatusCode.OUT_OF_RANGE, "The range lies outside the file"),
    errors.UnsupportedMediaTypeError: Status(415, grpc.StatusCode.INVALID_ARGUMENT, "The body has another type"),
    errors.UploadLockedError: Status(423, grpc.StatusCode.FAILED_PRECONDITION, "The upload is locked"),
    errors.TusVersionError: Status(
        412, grpc.StatusCode.FAILED_PRECONDITION, "The protocol's version is not spoken here"
    ),
    # 413 although RESOURCE_EXHAUSTED is 503 elsewhere: the request itself is too large, a retry cannot help.
    errors.LimitExceededError: Status(413, grpc.StatusCode.RESOURCE_EXHAUSTED, "The request passes a limit"),
    # Not 429: a retry gets the same answer.
    errors.QuotaError: Status(403, grpc.StatusCode.RESOURCE_EXHAUSTED, "The key's quota is used up"),
    errors.RateLimitedError: Status(429, grpc.StatusCode.RESOURCE_EXHAUSTED, "Too many requests"),
    errors.OverloadedError: _OF_KIND[Kind.RESOURCE_EXHAUSTED],
}
"""Classes whose status is not that of their kind."""


@dataclass(frozen=True)
class Refusal:
    """A protocol-independent error answer."""

    status: Status
    reason: str  # UPPER_SNAKE_CASE, stable across releases
    detail: str  # one sentence on this occurrence
    details: dict[str, str]  # any of field, limit and hint
    request_id: str  # identifies the request in the server's log
    retry_after_s: float | None = None

    def as_problem(self) -> Problem:
        """Converts to the problem+json object (RFC 9457)."""
        return Problem(
            type=f"urn:{DOMAIN}:problem:{self.reason.lower().replace('_', '-')}",
            title=self.status.title,
            status=self.status.http,
            detail=self.detail,
            reason=self.reason,
            request_id=self.request_id,
            **self.details,
        )

    def as_rpc_status(self) -> status_pb2.Status:
        """Converts to a google.rpc.Status with ErrorInfo, and RetryInfo if `retry_after_s` is set."""
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
    return _APART.get(type(error), _OF_KIND[error.kind])


def refusal_of(error: Exception, request_id: str) -> Refusal:
    """Describes any exception; unexpected ones are logged and reveal no details."""
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        _log.warning("request %s met a full disk: %s", request_id, error)
        error = errors.ResourceError(
            "the server's disk is full; nothing of the request was stored",
            field="data_dir",
            hint="Delete scenes that are not needed any more, or free space on the server, then send it again.",
        )
    if isinstance(error, FastSplatError):
        if error.kind is Kind.INTERNAL:
            _log.error("request %s failed: %s", request_id, error, exc_info=error)
        details = {name: _shortened(value) for name, value in error.details().items()}
        return Refusal(
            status_of(error), error.reason, _shortened(error.message), details, request_id, error.retry_after_s
        )
    _log.error("request %s failed unexpectedly", request_id, exc_info=error)
    return Refusal(
        _OF_KIND[Kind.INTERNAL],
        "INTERNAL",
        "The server failed unexpectedly; its log has the cause under this request id.",
        {"hint": "Try again; if it stays, report it with the request id."},
        request_id,
    )


def accepted_request_id(proposed: str) -> str:
    """Accepts a caller's id that is short and safe to log, else makes one."""
    return proposed if _REQUEST_ID.fullmatch(proposed) else uuid.uuid4().hex


def _shortened(text: str) -> str:
    text = text.encode(errors="replace").decode()  # a lone surrogate cannot be encoded in an answer
    return text if len(text) <= _MAX_CHARS else f"{text[: _MAX_CHARS - 1]}…"
