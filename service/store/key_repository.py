"""Access keys in the database: their hashes, never the keys."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import get_args

from sqlalchemy import ColumnElement, Connection, Engine, and_, func, insert, or_, select, update
from sqlalchemy.exc import IntegrityError

from fastsplat.service.store.database import transaction
from fastsplat.service.store.records import DEFAULT_PROJECT
from fastsplat.service.store.schema import api_keys
from fastsplat_contract.errors import NotFoundError
from fastsplat_contract.keys import Role

ROLES: tuple[Role, ...] = get_args(Role)
"""Each may do what those before it may, but the first two: see `fastsplat_contract.call.Rule`."""


@dataclass(frozen=True)
class KeyRecord:
    """One key, revoked ones included. Times are seconds since 1970, UTC.

    Attributes:
        id: part of the key itself, and of log lines.
        name: for people.
        role: uploaders post one scene; suggesters suggest names; readers query and view; editors also create and
            change; admins also delete; operators also do all that in any project.
        hash: hex sha256 of the whole key.
        created_at: when it was made.
        expires_at: when it ends; None: never.
        revoked_at: when it was revoked; None: it was not.
        project: whose scenes it sees.
        scene_id: the one scene of the project that it sees; "" for all.
        operation_id: of a key for one upload: the operation that it made; None: none.
    """

    id: str
    name: str
    role: Role
    hash: str
    created_at: float
    expires_at: float | None = None
    revoked_at: float | None = None
    project: str = DEFAULT_PROJECT
    scene_id: str = ""
    operation_id: str | None = None

    def valid(self, now: float) -> bool:
        """Whether it is accepted at time `now`."""
        return self.revoked_at is None and (self.expires_at is None or now < self.expires_at)


def use_key(connection: Connection, key_id: str, operation_id: str, now: float) -> bool:
    """Note the one operation that a key for one upload makes, in the transaction that makes it.

    False if the key has made one, or is not valid at time `now`.
    """
    unused = update(api_keys).where(api_keys.c.id == key_id, api_keys.c.operation_id.is_(None), _valid(now))
    return bool(connection.execute(unused.values(operation_id=operation_id)).rowcount)


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

    def valid(self, now: float) -> Sequence[KeyRecord]:
        """Every key that is valid at time `now`, oldest first."""
        with transaction(self._engine.execution_options(read_only=True)) as connection:
            query = select(api_keys).where(_valid(now)).order_by(api_keys.c.created_at, api_keys.c.id)
            return [KeyRecord(**row) for row in connection.execute(query).mappings()]

    def find(self, key_id: str) -> KeyRecord | None:
        """The key of an id; None if there is none."""
        with transaction(self._engine.execution_options(read_only=True)) as connection:
            row = connection.execute(select(api_keys).where(api_keys.c.id == key_id)).mappings().first()
        return None if row is None else KeyRecord(**row)

    def of_project(
        self,
        project: str,
        roles: Sequence[Role],
        limit: int,
        after: tuple[float, str] | None = None,
        scene_id: str = "",
    ) -> Sequence[KeyRecord]:
        """Up to `limit` keys of a project and of these roles, newest first, those after (created_at, id); with a scene,
        only those that show it alone."""
        rows = api_keys.c
        query = select(api_keys).where(rows.project == project, rows.role.in_(roles))
        if scene_id:
            query = query.where(rows.scene_id == scene_id)
        query = query.order_by(rows.created_at.desc(), rows.id.desc()).limit(limit)
        if after is not None:
            created, key_id = after
            same_time = and_(rows.created_at == created, rows.id < key_id)
            query = query.where(or_(rows.created_at < created, same_time))
        with transaction(self._engine.execution_options(read_only=True)) as connection:
            return [KeyRecord(**row) for row in connection.execute(query).mappings()]

    def count(self, project: str, now: float, made_since: float) -> int:
        """How many keys of a project are valid at time `now`, or were made after `made_since`."""
        counted = or_(_valid(now), api_keys.c.created_at > made_since)
        query = select(func.count()).where(api_keys.c.project == project, counted)
        with transaction(self._engine.execution_options(read_only=True)) as connection:
            return connection.scalar(query) or 0

    def prolong(self, key_id: str, expires_at: float) -> None:
        """Let a key that expires do so no earlier than this."""
        this_key = update(api_keys).where(api_keys.c.id == key_id, api_keys.c.expires_at < expires_at)
        with transaction(self._engine) as connection:
            connection.execute(this_key.values(expires_at=expires_at))

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

    def revoke_of_scene(self, scene_id: str, now: float) -> None:
        """Revoke the keys that show this scene alone."""
        own = update(api_keys).where(api_keys.c.scene_id == scene_id, api_keys.c.revoked_at.is_(None))
        with transaction(self._engine) as connection:
            connection.execute(own.values(revoked_at=now))


def _valid(now: float) -> ColumnElement[bool]:
    unexpired = or_(api_keys.c.expires_at.is_(None), api_keys.c.expires_at > now)
    return and_(api_keys.c.revoked_at.is_(None), unexpired)
