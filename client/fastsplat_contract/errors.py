"""Every error that a caller can meet: one tree, with a reason that is stable across releases.

    FastSplatError                          kind                  reason
    ├── InvalidInputError                   INVALID_ARGUMENT      INVALID_INPUT
    │   ├── UnsafeArchiveError                                    UNSAFE_ARCHIVE
    │   ├── CorruptImageError                                     CORRUPT_IMAGE
    │   ├── ChecksumMismatchError                                 CHECKSUM_MISMATCH
    │   ├── MethodNotAllowedError                                 METHOD_NOT_ALLOWED
    │   ├── RangeNotSatisfiableError                              RANGE_NOT_SATISFIABLE
    │   └── UnsupportedMediaTypeError                             UNSUPPORTED_MEDIA_TYPE
    ├── NotFoundError                       NOT_FOUND             NOT_FOUND
    ├── ConflictError                       ALREADY_EXISTS        CONFLICT
    ├── NotReadyError                       FAILED_PRECONDITION   NOT_READY
    ├── ReconstructionError                 FAILED_PRECONDITION   RECONSTRUCTION_FAILED
    ├── ModelUnavailableError               FAILED_PRECONDITION   MODEL_UNAVAILABLE
    ├── MissingPackageError                 FAILED_PRECONDITION   MISSING_PACKAGE
    ├── OffsetConflictError                 FAILED_PRECONDITION   OFFSET_CONFLICT
    ├── UploadLockedError                   FAILED_PRECONDITION   UPLOAD_LOCKED
    ├── TusVersionError                     FAILED_PRECONDITION   TUS_VERSION
    ├── LimitExceededError                  RESOURCE_EXHAUSTED    LIMIT_EXCEEDED
    ├── ResourceError                       RESOURCE_EXHAUSTED    OUT_OF_RESOURCES
    ├── QuotaError                          RESOURCE_EXHAUSTED    QUOTA
    ├── RateLimitedError                    RESOURCE_EXHAUSTED    RATE_LIMITED
    │   └── OverloadedError                                       OVERLOADED
    ├── CancelledError                      CANCELLED             CANCELLED
    ├── DeadlineExceededError               DEADLINE_EXCEEDED     DEADLINE_EXCEEDED
    ├── UnauthenticatedError                UNAUTHENTICATED       UNAUTHENTICATED
    ├── PermissionDeniedError               PERMISSION_DENIED     PERMISSION_DENIED
    ├── NotReadyNowError                    UNAVAILABLE           UNAVAILABLE
    ├── CaptionerError                      UNAVAILABLE           CAPTIONER_FAILED
    ├── DatabaseError                       UNAVAILABLE           DATABASE_UNAVAILABLE
    ├── ObjectStoreError                    UNAVAILABLE           OBJECT_STORE_UNAVAILABLE
    ├── ArtefactError                       INTERNAL              ARTEFACT_DAMAGED
    ├── SceneFileError                      INTERNAL              SCENE_DAMAGED
    │   └── SceneSchemaError                FAILED_PRECONDITION   SCENE_SCHEMA
    ├── TrainingDivergedError               INTERNAL              TRAINING_DIVERGED
    ├── TrainerCrashedError                 INTERNAL              TRAINER_CRASHED
    └── WorkerCrashedError                  INTERNAL              WORKER_CRASHED

The server maps each class to an HTTP and a gRPC status; a client gets back the class that the server raised.
"""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from typing import Self  # Python 3.10, which the client runs on, lacks it


class Kind(Enum):
    """What went wrong, in the words of gRPC's canonical status codes."""

    INVALID_ARGUMENT = "INVALID_ARGUMENT"
    NOT_FOUND = "NOT_FOUND"
    ALREADY_EXISTS = "ALREADY_EXISTS"
    FAILED_PRECONDITION = "FAILED_PRECONDITION"
    RESOURCE_EXHAUSTED = "RESOURCE_EXHAUSTED"
    CANCELLED = "CANCELLED"
    DEADLINE_EXCEEDED = "DEADLINE_EXCEEDED"
    UNAUTHENTICATED = "UNAUTHENTICATED"
    PERMISSION_DENIED = "PERMISSION_DENIED"
    UNAVAILABLE = "UNAVAILABLE"
    INTERNAL = "INTERNAL"


class FastSplatError(Exception):
    """Base of every error a user can meet.

    Args:
        message: what is wrong, in one sentence, with the offending value.
        hint: what the user can do about it, in one sentence; by default the class's own.
        field: the input's name (a form field, a file inside the upload, a setting), if one is to blame.
        limit: the bound that was crossed, as text with its unit and the setting that moves it, if any.

    Class attributes: `kind` (see `Kind`); `reason`, an UPPER_SNAKE_CASE name that is stable across releases; `recurs`,
    whether the same input meets this error again, whatever the server's state is.

    Examples:
        >>> error = InvalidInputError("no label of that id", field="label")
        >>> error.within("edits[3]").details(), error.kind.value, error.recurs
        ({'field': 'edits[3].label'}, 'INVALID_ARGUMENT', True)
    """

    kind: ClassVar[Kind] = Kind.INTERNAL
    reason: ClassVar[str] = "INTERNAL"
    recurs: ClassVar[bool] = False
    usual_hint: ClassVar[str] = ""
    usual_field: ClassVar[str] = ""
    retry_after_s: float | None = None
    """Seconds after which the same request may succeed; None: nothing is known about that."""
    request_id: str = ""
    """Finds the request in the server's log; "" where the error came from no server."""

    def __init_subclass__(cls, *, kind: Kind | None = None, reason: str = "", recurs: bool = False) -> None:
        cls.kind, cls.reason, cls.recurs = kind or cls.kind, reason or cls.reason, recurs or cls.recurs

    def __init__(self, message: str, *, hint: str = "", field: str = "", limit: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint or self.usual_hint
        self.field = field or self.usual_field
        self.limit = limit

    @classmethod
    def of(cls, field: str, problem: str, hint: str = "", limit: str = "") -> Self:
        """The error whose message is its field and what is wrong with it: "has ...", or after a colon ": ..."."""
        between = "" if problem.startswith(":") else " "
        return cls(f"{field}{between}{problem}", hint=hint, field=field, limit=limit)

    def details(self) -> dict[str, str]:
        """The non-empty parts besides the message, ready for problem+json and google.rpc.ErrorInfo."""
        parts = {"field": self.field, "limit": self.limit, "hint": self.hint}
        return {name: value for name, value in parts.items() if value}

    def within(self, prefix: str) -> FastSplatError:
        """The same error with a field that lies inside `prefix`: "edits[3]" and "label" make "edits[3].label"."""
        field = f"{prefix}.{self.field}" if self.field else prefix
        error = type(self)(self.message, hint=self.hint, field=field, limit=self.limit)
        error.retry_after_s = self.retry_after_s
        return error


class InvalidInputError(FastSplatError, kind=Kind.INVALID_ARGUMENT, reason="INVALID_INPUT", recurs=True):
    """The request or a file in it is malformed."""


class UnsafeArchiveError(InvalidInputError, reason="UNSAFE_ARCHIVE"):
    """An archive tries to leave its folder, hides links or devices, or is a decompression bomb."""


class CorruptImageError(InvalidInputError, reason="CORRUPT_IMAGE"):
    """A file that should be an image cannot be decoded to its last row."""


class ChecksumMismatchError(InvalidInputError, reason="CHECKSUM_MISMATCH"):
    """A piece is not what its checksum says; nothing of it was kept."""


class MethodNotAllowedError(InvalidInputError, reason="METHOD_NOT_ALLOWED"):
    """The path exists, but not with this HTTP method."""


class RangeNotSatisfiableError(InvalidInputError, reason="RANGE_NOT_SATISFIABLE"):
    """The requested range lies outside the file."""


class UnsupportedMediaTypeError(InvalidInputError, reason="UNSUPPORTED_MEDIA_TYPE"):
    """The body has a content type that this route does not read."""


class NotFoundError(FastSplatError, kind=Kind.NOT_FOUND, reason="NOT_FOUND"):
    """No scene, operation or label of that name."""


class ConflictError(FastSplatError, kind=Kind.ALREADY_EXISTS, reason="CONFLICT"):
    """The request id was used before for a different request."""


class NotReadyError(FastSplatError, kind=Kind.FAILED_PRECONDITION, reason="NOT_READY"):
    """Not now: a scene whose training has not finished, or has failed; a job that does not train right now."""


class ReconstructionError(FastSplatError, kind=Kind.FAILED_PRECONDITION, reason="RECONSTRUCTION_FAILED", recurs=True):
    """Structure from motion found no usable geometry in well-formed images."""


class ModelUnavailableError(FastSplatError, kind=Kind.FAILED_PRECONDITION, reason="MODEL_UNAVAILABLE"):
    """A model that the settings name is not in the model directory, or fails its checksum or contract."""


class MissingPackageError(FastSplatError, kind=Kind.FAILED_PRECONDITION, reason="MISSING_PACKAGE"):
    """An optional Python package that this call needs is not installed."""


class OffsetConflictError(FastSplatError, kind=Kind.FAILED_PRECONDITION, reason="OFFSET_CONFLICT"):
    """The piece does not begin where the upload ends."""


class UploadLockedError(FastSplatError, kind=Kind.FAILED_PRECONDITION, reason="UPLOAD_LOCKED"):
    """Another request is sending a piece of this upload."""


class TusVersionError(FastSplatError, kind=Kind.FAILED_PRECONDITION, reason="TUS_VERSION"):
    """The request speaks a version of the tus protocol that the server does not."""


class LimitExceededError(FastSplatError, kind=Kind.RESOURCE_EXHAUSTED, reason="LIMIT_EXCEEDED", recurs=True):
    """The input is well-formed but larger than this server accepts; `limit` names the bound."""


class ResourceError(FastSplatError, kind=Kind.RESOURCE_EXHAUSTED, reason="OUT_OF_RESOURCES"):
    """A memory, disk or pair-count bound of this server was hit; `limit` names it."""


class QuotaError(FastSplatError, kind=Kind.RESOURCE_EXHAUSTED, reason="QUOTA"):
    """What this key may hold (scenes, bytes, queued jobs) is used up; waiting alone does not help."""


class RateLimitedError(FastSplatError, kind=Kind.RESOURCE_EXHAUSTED, reason="RATE_LIMITED"):
    """This key calls too often, or has too many calls under way."""

    def __init__(
        self, message: str, *, hint: str = "", field: str = "", limit: str = "", retry_after_s: float = 1.0
    ) -> None:
        super().__init__(message, hint=hint, field=field, limit=limit)
        self.retry_after_s = retry_after_s


class OverloadedError(RateLimitedError, reason="OVERLOADED"):
    """The server has all the work it can answer in good time, whoever asks."""


class CancelledError(FastSplatError, kind=Kind.CANCELLED, reason="CANCELLED"):
    """The caller asked for the work to stop."""


class DeadlineExceededError(FastSplatError, kind=Kind.DEADLINE_EXCEEDED, reason="DEADLINE_EXCEEDED"):
    """The work was not done in the time it may take: the caller's, or the server's own limit."""


class UnauthenticatedError(FastSplatError, kind=Kind.UNAUTHENTICATED, reason="UNAUTHENTICATED"):
    """The call carries no key, or none that is valid."""


class PermissionDeniedError(FastSplatError, kind=Kind.PERMISSION_DENIED, reason="PERMISSION_DENIED"):
    """The key is valid, but not for this."""


class NotReadyNowError(FastSplatError, kind=Kind.UNAVAILABLE, reason="UNAVAILABLE"):
    """The process lives, but should get no requests now; the message says why."""


class CaptionerError(FastSplatError, kind=Kind.UNAVAILABLE, reason="CAPTIONER_FAILED"):
    """A model that was asked for names answers nothing, or something else than was asked for."""


class DatabaseError(FastSplatError, kind=Kind.UNAVAILABLE, reason="DATABASE_UNAVAILABLE"):
    """The database is away, locked or full; nothing of the request was stored."""

    usual_hint = "Send the request again in a moment, under the same request id."


class ObjectStoreError(FastSplatError, kind=Kind.UNAVAILABLE, reason="OBJECT_STORE_UNAVAILABLE"):
    """The object store is away, or refuses; nothing of the request was stored."""

    usual_hint = "Send the request again in a moment; its operator finds the cause in the store's own log."
    usual_field = "artefacts.url"


class ArtefactError(FastSplatError, kind=Kind.INTERNAL, reason="ARTEFACT_DAMAGED"):
    """A stored artefact is damaged or missing."""

    usual_hint = "Restore it from a backup, or post the capture again."


class SceneFileError(FastSplatError, kind=Kind.INTERNAL, reason="SCENE_DAMAGED"):
    """A scene folder on this server is damaged: a file is missing, cut short, altered, or contradicts another."""


class SceneSchemaError(SceneFileError, kind=Kind.FAILED_PRECONDITION, reason="SCENE_SCHEMA"):
    """A scene folder was written by a version of this software whose schema this one does not know."""


class TrainingDivergedError(FastSplatError, kind=Kind.INTERNAL, reason="TRAINING_DIVERGED", recurs=True):
    """The optimization left the finite numbers, or its pictures are not like the photos; nothing was stored."""


class TrainerCrashedError(FastSplatError, kind=Kind.INTERNAL, reason="TRAINER_CRASHED"):
    """The trainer process died without an error: a signal, the out-of-memory killer, a crash in native code."""


class WorkerCrashedError(FastSplatError, kind=Kind.INTERNAL, reason="WORKER_CRASHED"):
    """The worker process died each time it ran this job, so the job is not started again."""
