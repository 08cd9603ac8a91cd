"""Quota usage of projects: scenes, uploaded bytes, unfinished jobs."""

from __future__ import annotations

from dataclasses import dataclass

from sqlalchemy import Connection, func, insert, select, text

from fastsplat.service.store.rows.database import Repository
from fastsplat.service.store.rows.schema import operations, quota_usage, scenes

_LOCK_SPACE = 0x484F4C44  # arbitrary, but the same for all processes


@dataclass(frozen=True)
class Usage:
    """A project's scenes, bytes of the uploads they were made from, and unfinished jobs."""

    scenes: int
    stored_bytes: int
    queued_jobs: int


class QuotaUsage(Repository):
    def of(self, project: str) -> Usage:
        """Returns a project's usage; may raise `DatabaseError`."""
        with self._reading() as connection:
            return _usage(connection, project)


def reserve(connection: Connection, project: str, scene_id: str, size: int) -> Usage:
    """Counts a scene of `size` bytes in its transaction; returns the new usage.

    Scenes of a project are made one after the other, so that two cannot both be the last within the quota: SQLite has
    one writer at a time, PostgreSQL takes an advisory lock for the project.
    """
    if connection.dialect.name == "postgresql":
        name = {"space": _LOCK_SPACE, "project": project}
        connection.execute(text("SELECT pg_advisory_xact_lock(:space, hashtext(:project))"), name)
    connection.execute(insert(quota_usage).values(scene_id=scene_id, bytes=size))
    return _usage(connection, project)


def _usage(connection: Connection, project: str) -> Usage:
    scene_usage = quota_usage.join(scenes, scenes.c.id == quota_usage.c.scene_id)
    counted = select(func.count(), func.coalesce(func.sum(quota_usage.c.bytes), 0)).select_from(scene_usage)
    count, size = connection.execute(counted.where(scenes.c.project == project)).one()
    waiting = select(func.count()).select_from(operations.join(scenes, operations.c.scene_id == scenes.c.id))
    jobs = connection.scalar(waiting.where(scenes.c.project == project, operations.c.state.in_(("QUEUED", "RUNNING"))))
    return Usage(int(count), int(size), int(jobs or 0))
