"""Errors of the database, the object store and stored artefacts."""

from __future__ import annotations

from fastsplat.service.common.errors import FastSplatError, Kind


class DatabaseError(FastSplatError):
    """The database is away, locked or full; nothing of the request was stored."""

    kind = Kind.UNAVAILABLE
    reason = "DATABASE_UNAVAILABLE"

    def __init__(self, message: str) -> None:
        super().__init__(message, hint="Send the request again in a moment, under the same request id.")


class ObjectStoreError(FastSplatError):
    """The object store is away, or refuses; nothing of the request was stored."""

    kind = Kind.UNAVAILABLE
    reason = "OBJECT_STORE_UNAVAILABLE"

    def __init__(self, message: str) -> None:
        super().__init__(
            message,
            field="artefacts.url",
            hint="Send the request again in a moment; its operator finds the cause in the store's own log.",
        )


class ArtefactError(FastSplatError):
    """A stored artefact is damaged or missing."""

    kind = Kind.INTERNAL
    reason = "ARTEFACT_DAMAGED"

    def __init__(self, message: str) -> None:
        super().__init__(message, hint="Restore it from a backup, or post the capture again.")
