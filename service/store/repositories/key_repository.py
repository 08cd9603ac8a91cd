"""Access keys in the database: hashes only, never the keys."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import get_args

from sqlalchemy import ColumnElement, Connection, and_, func, insert, or_, select, tuple_, update
from sqlalchemy.exc import IntegrityError

from fastsplat.service.store.rows.database import Repository
from fastsplat.service.store.rows.records import DEFAULT_PROJECT
from fastsplat.service.store.rows.schema import api_keys
from fastsplat_contract.errors import NotFoundError
from fastsplat_contract.server.keys import Role

ROLES: tuple[Role, ...] = get_args(Role)
"""In order of increasing rights, apart from the first two; see `fastsplat_contract.call.Rule`."""


@dataclass(frozen=True)
class KeyRecord:
    """An access key, possibly revoked; times are seconds since 1970, UTC.

    Uploaders post one scene; suggesters suggest names; readers query and view; editors also create and change; admins
    also delete; operators do all that in any project.
    """

    id: str  # part of the key itself, and of log lines
    name: str
    role: Role
    hash: str  # hex SHA-256 of the whole key
    created_at: float
    expires_at: float | None = None
    revoked_at: float | None = None
    project: str = DEFAULT_PROJECT
    scene_id: str = ""  # the only scene that it gives access to; "": all of the project
    operation_id: str | None = None  # made with a key for one upload

    def valid(self, now: float) -> bool:
        """True if the key is accepted at time `now`."""
        return self.revoked_at is None and (self.expires_at is None or now < self.expires_at)


def use_key(connection: Connection, key_id: str, operation_id: str, now: float) -> bool:
    """Notes the only operation of a key for one upload, in its transaction.

    Returns False if the key was used before or is not valid at time `now`.
    """
    unused = update(api_keys).where(api_keys.c.id == key_id, api_keys.c.operation_id.is_(None), _valid(now))
    return bool(connection.execute(unused.values(operation_id=operation_id)).rowcount)


class KeyRepository(Repository):
    """Access keys; each method is one transaction and may raise `DatabaseError`."""

    def add(self, record: KeyRecord) -> bool:
        """Inserts a key; False if its id is taken."""
        try:
            with self._writing() as connection:
                connection.execute(insert(api_keys).values(asdict(record)))
            return True
        except IntegrityError:
            return False

    def all(self) -> Sequence[KeyRecord]:
        """Lists every key ever made, oldest first."""
        with self._reading() as connection:
            rows = connection.execute(select(api_keys).order_by(api_keys.c.created_at, api_keys.c.id)).mappings()
            return [KeyRecord(**row) for row in rows]

    def valid(self, now: float) -> Sequence[KeyRecord]:
        """Lists the keys that are valid at time `now`, oldest first."""
        with self._reading() as connection:
            query = select(api_keys).where(_valid(now)).order_by(api_keys.c.created_at, api_keys.c.id)
            return [KeyRecord(**row) for row in connection.execute(query).mappings()]

    def find(self, key_id: str) -> KeyRecord | None:
        with self._reading() as connection:
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
        """Lists keys after (created_at, id), newest first; with a scene, only those limited to it."""
        rows = api_keys.c
        query = select(api_keys).where(rows.project == project, rows.role.in_(roles))
        if scene_id:
            query = query.where(rows.scene_id == scene_id)
        query = query.order_by(rows.created_at.desc(), rows.id.desc()).limit(limit)
        if after is not None:
            query = query.where(tuple_(rows.created_at, rows.id) < after)
        with self._reading() as connection:
            return [KeyRecord(**row) for row in connection.execute(query).mappings()]

    def count(self, project: str, now: float, made_since: float) -> int:
        """Counts the project's keys that are valid at time `now` or were made after `made_since`."""
        counted = or_(_valid(now), api_keys.c.created_at > made_since)
        query = select(func.count()).where(api_keys.c.project == project, counted)
        with self._reading() as connection:
            return connection.scalar(query) or 0

    def prolong(self, key_id: str, expires_at: float) -> None:
        """Extends a key's expiry to `expires_at`, unless it is later or never."""
        this_key = update(api_keys).where(api_keys.c.id == key_id, api_keys.c.expires_at < expires_at)
        with self._writing() as connection:
            connection.execute(this_key.values(expires_at=expires_at))

    def revoke(self, key_id: str, now: float) -> None:
        """Revokes a key, if it is not revoked; raises `NotFoundError` for an unknown id."""
        with self._writing() as connection:
            this_key = update(api_keys).where(api_keys.c.id == key_id)
            if not connection.execute(this_key.values(name=api_keys.c.name)).rowcount:
                raise NotFoundError(
                    f"no key {key_id[:80]!r}", field="key", hint="List the keys to see which there are."
                )
            connection.execute(this_key.where(api_keys.c.revoked_at.is_(None)).values(revoked_at=now))

    def revoke_of_scene(self, scene_id: str, now: float) -> None:
        """Revokes the keys that are limited to this scene."""
        revocation = update(api_keys).where(api_keys.c.scene_id == scene_id, api_keys.c.revoked_at.is_(None))
        with self._writing() as connection:
            connection.execute(revocation.values(revoked_at=now))


def _valid(now: float) -> ColumnElement[bool]:
    unexpired = or_(api_keys.c.expires_at.is_(None), api_keys.c.expires_at > now)
    return and_(api_keys.c.revoked_at.is_(None), unexpired)
