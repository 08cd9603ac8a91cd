"""Quota usage of projects: scenes, the bytes they were made of, jobs that wait or run."""

from __future__ import annotations

from dataclasses import dataclass

from sqlalchemy import Connection, Engine, delete, func, insert, select, text

from fastsplat.service.store.database import transaction
from fastsplat.service.store.schema import operations, quota_usage, scenes

_LOCK_SPACE = 0x484F4C44  # any number, the same for all processes that open one PostgreSQL database


@dataclass(frozen=True)
class Usage:
    """What one project uses now: scenes, bytes of the uploads they were made of, and jobs that are queued or run."""

    scenes: int
    stored_bytes: int
    queued_jobs: int


class QuotaUsage:
    """Usage of all projects, in the database."""

    def __init__(self, engine: Engine) -> None:
        self._reading = engine.execution_options(read_only=True)

    def of(self, project: str) -> Usage:
        """What a project uses now.

        Raises:
            DatabaseError: the database does not answer.
        """
        with transaction(self._reading) as connection:
            return _usage(connection, project)


def reserve(connection: Connection, project: str, scene_id: str, size: int) -> Usage:
    """Count a scene of `size` bytes against its project, in the transaction that makes it; returns the usage with it.

    A project's scenes are made one after the other, so that two of them cannot both be the last that a quota allows:
    SQLite has one writer at a time anyway, PostgreSQL's take a lock in the project's name.
    """
    if connection.dialect.name == "postgresql":
        name = {"space": _LOCK_SPACE, "project": project}
        connection.execute(text("SELECT pg_advisory_xact_lock(:space, hashtext(:project))"), name)
    connection.execute(delete(quota_usage).where(quota_usage.c.scene_id.not_in(select(scenes.c.id))))
    connection.execute(insert(quota_usage).values(scene_id=scene_id, bytes=size))
    return _usage(connection, project)


def _usage(connection: Connection, project: str) -> Usage:
    owned = quota_usage.join(scenes, scenes.c.id == quota_usage.c.scene_id)
    counted = select(func.count(), func.coalesce(func.sum(quota_usage.c.bytes), 0)).select_from(owned)
    count, size = connection.execute(counted.where(scenes.c.project == project)).one()
    waiting = select(func.count()).select_from(operations.join(scenes, operations.c.scene_id == scenes.c.id))
    jobs = connection.scalar(waiting.where(scenes.c.project == project, operations.c.state.in_(("QUEUED", "RUNNING"))))
    return Usage(int(count), int(size), int(jobs or 0))
