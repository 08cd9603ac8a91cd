"""One exception tree for the whole product; transports translate `Kind`, nobody else does."""

from __future__ import annotations

from enum import Enum
from typing import ClassVar


class Kind(Enum):
    """What went wrong, in gRPC's canonical vocabulary. `api` maps each to an HTTP status too."""

    INVALID_ARGUMENT = "INVALID_ARGUMENT"
    NOT_FOUND = "NOT_FOUND"
    ALREADY_EXISTS = "ALREADY_EXISTS"
    FAILED_PRECONDITION = "FAILED_PRECONDITION"
    RESOURCE_EXHAUSTED = "RESOURCE_EXHAUSTED"
    CANCELLED = "CANCELLED"
    UNAUTHENTICATED = "UNAUTHENTICATED"
    PERMISSION_DENIED = "PERMISSION_DENIED"
    UNAVAILABLE = "UNAVAILABLE"
    INTERNAL = "INTERNAL"


class FastSplatError(Exception):
    """Base of every error a user can meet.

    Args:
        message: what is wrong, in one sentence, with the offending value.
        hint: what the user can do about it, in one sentence.
        field: the input's name (a form field, a file inside the upload, a setting), if one is to blame.
        limit: the bound that was crossed, as text with its unit and the setting that moves it, if any.

    Class attributes: `kind` (see `Kind`) and `reason`, an UPPER_SNAKE_CASE name that is stable across releases.
    """

    kind: ClassVar[Kind] = Kind.INTERNAL
    reason: ClassVar[str] = "INTERNAL"
    retry_after_s: float | None = None
    """Seconds after which the same request may succeed; None: nothing is known about that."""

    def __init__(self, message: str, *, hint: str = "", field: str = "", limit: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint
        self.field = field
        self.limit = limit

    def details(self) -> dict[str, str]:
        """The non-empty parts besides the message, ready for problem+json and google.rpc.ErrorInfo."""
        parts = {"field": self.field, "limit": self.limit, "hint": self.hint}
        return {name: value for name, value in parts.items() if value}


class InvalidInputError(FastSplatError):
    """The request or a file in it is malformed."""

    kind = Kind.INVALID_ARGUMENT
    reason = "INVALID_INPUT"


class LimitExceededError(FastSplatError):
    """The input is well-formed but larger than this server accepts; `limit` names the bound."""

    kind = Kind.RESOURCE_EXHAUSTED
    reason = "LIMIT_EXCEEDED"


class UnsafeArchiveError(InvalidInputError):
    """An archive tries to leave its folder, hides links or devices, or is a decompression bomb."""

    reason = "UNSAFE_ARCHIVE"


class CorruptImageError(InvalidInputError):
    """A file that should be an image cannot be decoded to its last row."""

    reason = "CORRUPT_IMAGE"


class ReconstructionError(FastSplatError):
    """Structure from motion found no usable geometry in well-formed images."""

    kind = Kind.FAILED_PRECONDITION
    reason = "RECONSTRUCTION_FAILED"


class ModelUnavailableError(FastSplatError):
    """A model that the settings name is not in the model directory, or fails its checksum or contract."""

    kind = Kind.FAILED_PRECONDITION
    reason = "MODEL_UNAVAILABLE"


class NotFoundError(FastSplatError):
    """No scene, operation or label of that name."""

    kind = Kind.NOT_FOUND
    reason = "NOT_FOUND"


class ConflictError(FastSplatError):
    """The request id was used before for a different request."""

    kind = Kind.ALREADY_EXISTS
    reason = "CONFLICT"


class NotReadyError(FastSplatError):
    """The scene exists but its training has not finished, or has failed."""

    kind = Kind.FAILED_PRECONDITION
    reason = "NOT_READY"


class CancelledError(FastSplatError):
    """The caller asked for the work to stop."""

    kind = Kind.CANCELLED
    reason = "CANCELLED"


class ResourceError(FastSplatError):
    """A memory, disk or pair-count bound of this server was hit; `limit` names it."""

    kind = Kind.RESOURCE_EXHAUSTED
    reason = "OUT_OF_RESOURCES"


class UnauthenticatedError(FastSplatError):
    """The call carries no key, or none that is valid."""

    kind = Kind.UNAUTHENTICATED
    reason = "UNAUTHENTICATED"


class PermissionDeniedError(FastSplatError):
    """The key is valid, but not for this."""

    kind = Kind.PERMISSION_DENIED
    reason = "PERMISSION_DENIED"


class RateLimitedError(FastSplatError):
    """This key calls too often, or has too many calls under way."""

    kind = Kind.RESOURCE_EXHAUSTED
    reason = "RATE_LIMITED"

    def __init__(
        self, message: str, *, hint: str = "", field: str = "", limit: str = "", retry_after_s: float = 1.0
    ) -> None:
        super().__init__(message, hint=hint, field=field, limit=limit)
        self.retry_after_s = retry_after_s


class OverloadedError(RateLimitedError):
    """The server has all the work it can answer in good time, whoever asks."""

    reason = "OVERLOADED"


class QuotaError(FastSplatError):
    """What this key may hold (scenes, bytes, queued jobs) is used up; waiting alone does not help."""

    kind = Kind.RESOURCE_EXHAUSTED
    reason = "QUOTA"
