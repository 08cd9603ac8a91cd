"""Rows of access keys: their hashes, never the keys."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Literal

from sqlalchemy import Column, Double, Engine, String, Table, insert, select, update
from sqlalchemy.exc import IntegrityError

from fastsplat.service.store.rows import transaction
from fastsplat.service.store.schema import metadata
from fastsplat_contract.errors import NotFoundError

KeyKind = Literal["write", "read"]

_keys = Table(
    "api_keys",
    metadata,
    Column("id", String(16), primary_key=True),
    Column("name", String(200), nullable=False),
    Column("kind", String(8), nullable=False),
    Column("hash", String(64), nullable=False),
    Column("created_at", Double, nullable=False),
    Column("expires_at", Double, nullable=True),
    Column("revoked_at", Double, nullable=True),
)


@dataclass(frozen=True)
class KeyRecord:
    """One key, revoked ones included. Times are seconds since 1970, UTC.

    Attributes:
        id: stands in the key itself and in logs.
        name: for people.
        kind: "read" keys ask and look; "write" keys also make, change and delete.
        hash: hex sha256 of the whole key.
        created_at: when it was made.
        expires_at: when it ends; None: never.
        revoked_at: when it was taken back; None: it was not.
    """

    id: str
    name: str
    kind: KeyKind
    hash: str
    created_at: float
    expires_at: float | None = None
    revoked_at: float | None = None

    def valid(self, now: float) -> bool:
        """Whether it opens anything at time `now`."""
        return self.revoked_at is None and (self.expires_at is None or now < self.expires_at)


class KeyRows:
    """Access keys in the database; every method is one transaction. All raise `DatabaseError` when it is away."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def add(self, record: KeyRecord) -> bool:
        """Insert a key. False if there is one of that id already."""
        try:
            with transaction(self._engine) as connection:
                connection.execute(insert(_keys).values(asdict(record)))
            return True
        except IntegrityError:
            return False

    def all(self) -> Sequence[KeyRecord]:
        """Every key ever made, oldest first."""
        with transaction(self._engine.execution_options(read_only=True)) as connection:
            rows = connection.execute(select(_keys).order_by(_keys.c.created_at, _keys.c.id)).mappings()
            return [KeyRecord(**row) for row in rows]

    def revoke(self, key_id: str, now: float) -> None:
        """Take a key back; one that is revoked stays so.

        Raises:
            NotFoundError: there is none of that id.
        """
        with transaction(self._engine) as connection:
            found = update(_keys).where(_keys.c.id == key_id)
            if not connection.execute(found.values(name=_keys.c.name)).rowcount:
                raise NotFoundError(
                    f"no key {key_id[:80]!r}", field="key", hint="List the keys to see which there are."
                )
            connection.execute(found.where(_keys.c.revoked_at.is_(None)).values(revoked_at=now))
