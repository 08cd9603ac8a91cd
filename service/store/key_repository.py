"""Access keys in the database: their hashes, never the keys."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Literal

from sqlalchemy import Engine, insert, select, update
from sqlalchemy.exc import IntegrityError

from fastsplat.service.store.database import transaction
from fastsplat.service.store.schema import api_keys
from fastsplat_contract.errors import NotFoundError

KeyKind = Literal["write", "read"]


@dataclass(frozen=True)
class KeyRecord:
    """One key, revoked ones included. Times are seconds since 1970, UTC.

    Attributes:
        id: part of the key itself, and of log lines.
        name: for people.
        kind: "read" keys query and view; "write" keys also create, change and delete.
        hash: hex sha256 of the whole key.
        created_at: when it was made.
        expires_at: when it ends; None: never.
        revoked_at: when it was revoked; None: it was not.
    """

    id: str
    name: str
    kind: KeyKind
    hash: str
    created_at: float
    expires_at: float | None = None
    revoked_at: float | None = None

    def valid(self, now: float) -> bool:
        """Whether it is accepted at time `now`."""
        return self.revoked_at is None and (self.expires_at is None or now < self.expires_at)


class KeyRepository:
    """Access keys in the database; every method is one transaction. All raise `DatabaseError` when it is away."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def add(self, record: KeyRecord) -> bool:
        """Insert a key. False if there is one of that id already."""
        try:
            with transaction(self._engine) as connection:
                connection.execute(insert(api_keys).values(asdict(record)))
            return True
        except IntegrityError:
            return False

    def all(self) -> Sequence[KeyRecord]:
        """Every key ever made, oldest first."""
        with transaction(self._engine.execution_options(read_only=True)) as connection:
            rows = connection.execute(select(api_keys).order_by(api_keys.c.created_at, api_keys.c.id)).mappings()
            return [KeyRecord(**row) for row in rows]

    def revoke(self, key_id: str, now: float) -> None:
        """Revoke a key; one that is revoked stays so.

        Raises:
            NotFoundError: there is none of that id.
        """
        with transaction(self._engine) as connection:
            this_key = update(api_keys).where(api_keys.c.id == key_id)
            if not connection.execute(this_key.values(name=api_keys.c.name)).rowcount:
                raise NotFoundError(
                    f"no key {key_id[:80]!r}", field="key", hint="List the keys to see which there are."
                )
            connection.execute(this_key.where(api_keys.c.revoked_at.is_(None)).values(revoked_at=now))
