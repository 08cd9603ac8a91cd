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


class InvalidInputError(FastSplatError):
    """The request or a file in it is malformed."""

    kind = Kind.INVALID_ARGUMENT
    reason = "INVALID_INPUT"
    recurs = True


class UnsafeArchiveError(InvalidInputError):
    """An archive tries to leave its folder, hides links or devices, or is a decompression bomb."""

    reason = "UNSAFE_ARCHIVE"


class CorruptImageError(InvalidInputError):
    """A file that should be an image cannot be decoded to its last row."""

    reason = "CORRUPT_IMAGE"


class ChecksumMismatchError(InvalidInputError):
    """A piece is not what its checksum says; nothing of it was kept."""

    reason = "CHECKSUM_MISMATCH"


class MethodNotAllowedError(InvalidInputError):
    """The path exists, but not with this HTTP method."""

    reason = "METHOD_NOT_ALLOWED"


class RangeNotSatisfiableError(InvalidInputError):
    """The requested range lies outside the file."""

    reason = "RANGE_NOT_SATISFIABLE"


class UnsupportedMediaTypeError(InvalidInputError):
    """The body has a content type that this route does not read."""

    reason = "UNSUPPORTED_MEDIA_TYPE"


class NotFoundError(FastSplatError):
    """No scene, operation or label of that name."""

    kind = Kind.NOT_FOUND
    reason = "NOT_FOUND"


class ConflictError(FastSplatError):
    """The request id was used before for a different request."""

    kind = Kind.ALREADY_EXISTS
    reason = "CONFLICT"


class NotReadyError(FastSplatError):
    """Not now: a scene whose training has not finished, or has failed; a job that does not train right now."""

    kind = Kind.FAILED_PRECONDITION
    reason = "NOT_READY"


class ReconstructionError(FastSplatError):
    """Structure from motion found no usable geometry in well-formed images."""

    kind = Kind.FAILED_PRECONDITION
    reason = "RECONSTRUCTION_FAILED"
    recurs = True


class ModelUnavailableError(FastSplatError):
    """A model that the settings name is not in the model directory, or fails its checksum or contract."""

    kind = Kind.FAILED_PRECONDITION
    reason = "MODEL_UNAVAILABLE"


class MissingPackageError(FastSplatError):
    """An optional Python package that this call needs is not installed."""

    kind = Kind.FAILED_PRECONDITION
    reason = "MISSING_PACKAGE"


class OffsetConflictError(FastSplatError):
    """The piece does not begin where the upload ends."""

    kind = Kind.FAILED_PRECONDITION
    reason = "OFFSET_CONFLICT"


class UploadLockedError(FastSplatError):
    """Another request is sending a piece of this upload."""

    kind = Kind.FAILED_PRECONDITION
    reason = "UPLOAD_LOCKED"


class TusVersionError(FastSplatError):
    """The request speaks a version of the tus protocol that the server does not."""

    kind = Kind.FAILED_PRECONDITION
    reason = "TUS_VERSION"


class LimitExceededError(FastSplatError):
    """The input is well-formed but larger than this server accepts; `limit` names the bound."""

    kind = Kind.RESOURCE_EXHAUSTED
    reason = "LIMIT_EXCEEDED"
    recurs = True


class ResourceError(FastSplatError):
    """A memory, disk or pair-count bound of this server was hit; `limit` names it."""

    kind = Kind.RESOURCE_EXHAUSTED
    reason = "OUT_OF_RESOURCES"


class QuotaError(FastSplatError):
    """What this key may hold (scenes, bytes, queued jobs) is used up; waiting alone does not help."""

    kind = Kind.RESOURCE_EXHAUSTED
    reason = "QUOTA"


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


class CancelledError(FastSplatError):
    """The caller asked for the work to stop."""

    kind = Kind.CANCELLED
    reason = "CANCELLED"


class DeadlineExceededError(FastSplatError):
    """The work was not done in the time it may take: the caller's, or the server's own limit."""

    kind = Kind.DEADLINE_EXCEEDED
    reason = "DEADLINE_EXCEEDED"


class UnauthenticatedError(FastSplatError):
    """The call carries no key, or none that is valid."""

    kind = Kind.UNAUTHENTICATED
    reason = "UNAUTHENTICATED"


class PermissionDeniedError(FastSplatError):
    """The key is valid, but not for this."""

    kind = Kind.PERMISSION_DENIED
    reason = "PERMISSION_DENIED"


class NotReadyNowError(FastSplatError):
    """The process lives, but should get no requests now; the message says why."""

    kind = Kind.UNAVAILABLE
    reason = "UNAVAILABLE"


class CaptionerError(FastSplatError):
    """A model that was asked for names answers nothing, or something else than was asked for."""

    kind = Kind.UNAVAILABLE
    reason = "CAPTIONER_FAILED"


class DatabaseError(FastSplatError):
    """The database is away, locked or full; nothing of the request was stored."""

    kind = Kind.UNAVAILABLE
    reason = "DATABASE_UNAVAILABLE"
    usual_hint = "Send the request again in a moment, under the same request id."


class ObjectStoreError(FastSplatError):
    """The object store is away, or refuses; nothing of the request was stored."""

    kind = Kind.UNAVAILABLE
    reason = "OBJECT_STORE_UNAVAILABLE"
    usual_hint = "Send the request again in a moment; its operator finds the cause in the store's own log."
    usual_field = "artefacts.url"


class ArtefactError(FastSplatError):
    """A stored artefact is damaged or missing."""

    kind = Kind.INTERNAL
    reason = "ARTEFACT_DAMAGED"
    usual_hint = "Restore it from a backup, or post the capture again."


class SceneFileError(FastSplatError):
    """A scene folder on this server is damaged: a file is missing, cut short, altered, or contradicts another."""

    kind = Kind.INTERNAL
    reason = "SCENE_DAMAGED"


class SceneSchemaError(SceneFileError):
    """A scene folder was written by a version of this software whose schema this one does not know."""

    kind = Kind.FAILED_PRECONDITION
    reason = "SCENE_SCHEMA"


class TrainingDivergedError(FastSplatError):
    """The optimization left the finite numbers, or its pictures are not like the photos; nothing was stored."""

    kind = Kind.INTERNAL
    reason = "TRAINING_DIVERGED"
    recurs = True


class TrainerCrashedError(FastSplatError):
    """The trainer process died without an error: a signal, the out-of-memory killer, a crash in native code."""

    kind = Kind.INTERNAL
    reason = "TRAINER_CRASHED"


class WorkerCrashedError(FastSplatError):
    """The worker process died each time it ran this job, so the job is not started again."""

    kind = Kind.INTERNAL
    reason = "WORKER_CRASHED"
