"""What each key holds: scenes, the bytes they were made of, jobs that wait or run."""

from __future__ import annotations

from dataclasses import dataclass

from sqlalchemy import BigInteger, Column, Connection, Engine, String, Table, delete, func, insert, select, text

from fastsplat.service.store.rows import transaction
from fastsplat.service.store.schema import metadata, operations, scenes

_LOCK_SPACE = 0x484F4C44  # any number, the same for all processes that open one PostgreSQL database

_holdings = Table(
    "holdings",
    metadata,
    Column("scene_id", String(40), primary_key=True),
    Column("owner", String(16), nullable=False, index=True),
    Column("bytes", BigInteger, nullable=False),
)


@dataclass(frozen=True)
class Held:
    """What one key holds now."""

    scenes: int
    stored_bytes: int
    queued_jobs: int


class HoldingRows:
    """Holdings in the database."""

    def __init__(self, engine: Engine) -> None:
        self._reading = engine.execution_options(read_only=True)

    def held(self, owner: str) -> Held:
        """What a key holds now.

        Raises:
            DatabaseError: the database does not answer.
        """
        with transaction(self._reading) as connection:
            return _held(connection, owner)


def take(connection: Connection, owner: str, scene_id: str, size: int) -> Held:
    """Within the transaction that makes a scene: book it on its owner. Returns what the owner then holds.

    One owner's scenes are made one after the other, so that two of them cannot both be the last that a quota allows:
    SQLite's writers are alone anyway, PostgreSQL's take a lock in the owner's name.
    """
    if connection.dialect.name == "postgresql":
        name = {"space": _LOCK_SPACE, "owner": owner}
        connection.execute(text("SELECT pg_advisory_xact_lock(:space, hashtext(:owner))"), name)
    connection.execute(delete(_holdings).where(_holdings.c.scene_id.not_in(select(scenes.c.id))))
    connection.execute(insert(_holdings).values(scene_id=scene_id, owner=owner, bytes=size))
    return _held(connection, owner)


def _held(connection: Connection, owner: str) -> Held:
    owned = _holdings.join(scenes, scenes.c.id == _holdings.c.scene_id)
    counted = select(func.count(), func.coalesce(func.sum(_holdings.c.bytes), 0)).select_from(owned)
    count, size = connection.execute(counted.where(_holdings.c.owner == owner)).one()
    waiting = select(func.count()).select_from(owned.join(operations, operations.c.id == scenes.c.operation_id))
    jobs = connection.scalar(waiting.where(_holdings.c.owner == owner, operations.c.state.in_(("QUEUED", "RUNNING"))))
    return Held(int(count), int(size), int(jobs or 0))
