"""Worker processes and their heartbeats."""

from __future__ import annotations

import time
from collections.abc import Sequence

from sqlalchemy import delete, func, insert, select, update

from fastsplat.service.store.rows.database import Repository, upsert
from fastsplat.service.store.rows.records import WorkerRecord
from fastsplat.service.store.rows.schema import leases, workers


class WorkerRepository(Repository):
    """One row a worker; each method is one transaction and may raise `DatabaseError`."""

    def update_heartbeat(self, executor_id: str, host: str, pid: int) -> None:
        """Sets a worker's heartbeat to now; the first one registers it."""
        now = time.time()
        with self._writing() as connection:
            known = update(workers).where(workers.c.executor_id == executor_id)
            if not connection.execute(known.values(heartbeat_at=now)).rowcount:
                row = {"executor_id": executor_id, "host": host, "pid": pid, "heartbeat_at": now}
                after_boot = time.clock_gettime(time.CLOCK_BOOTTIME)
                connection.execute(insert(workers).values(**row, started_at=after_boot))

    def list_workers(self) -> Sequence[WorkerRecord]:
        with self._reading() as connection:
            rows = connection.execute(select(workers)).all()
        return [WorkerRecord(row.executor_id, row.host, row.pid, row.started_at, row.heartbeat_at) for row in rows]

    def alive_on(self, host: str, timeout_s: float) -> bool:
        """True if a worker on this host had a heartbeat in the last `timeout_s` seconds."""
        fresh = workers.c.heartbeat_at >= time.time() - timeout_s
        query = select(workers.c.executor_id).where(workers.c.host == host, fresh).limit(1)
        with self._reading() as connection:
            return connection.execute(query).first() is not None

    def alive(self, timeout_s: float) -> int:
        """Counts the workers with a heartbeat in the last `timeout_s` seconds."""
        query = select(func.count()).where(workers.c.heartbeat_at >= time.time() - timeout_s)
        with self._reading() as connection:
            return connection.scalar(query) or 0

    def mark_stopped(self, executor_id: str) -> None:
        """Marks a worker as stopped, for recovery of its jobs without the timeout."""
        with self._writing() as connection:
            connection.execute(update(workers).where(workers.c.executor_id == executor_id).values(heartbeat_at=0.0))

    def take_lease(self, name: str, seconds: float) -> bool:
        """Leases a piece of work that all workers share; False while somebody has it."""
        now = time.time()
        # One that lasts for longer is of a machine whose clock is ahead.
        over = ~leases.c.until.between(now, now + seconds)
        with self._writing() as connection:
            return upsert(connection, {leases.c.name: name, leases.c.until: now + seconds}, over)

    def unregister(self, executor_id: str) -> None:
        """Removes a worker without jobs; if it still lives, its next heartbeat registers it again."""
        with self._writing() as connection:
            connection.execute(delete(workers).where(workers.c.executor_id == executor_id))
