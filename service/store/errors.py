"""What can go wrong between this product and its database."""

from __future__ import annotations

from service.common.errors import FastSplatError, Kind


class DatabaseError(FastSplatError):
    """The database is away, locked or full; nothing of the request was kept."""

    kind = Kind.UNAVAILABLE
    reason = "DATABASE_UNAVAILABLE"

    def __init__(self, message: str) -> None:
        super().__init__(message, hint="Send the request again in a moment, under the same request id.")
