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
            return [WorkerRecord(*row) for row in connection.execute(select(workers))]

    def alive(self, timeout_s: float, host: str | None = None) -> int:
        """Counts the workers (of a host; None: of all) with a heartbeat in the last `timeout_s` seconds."""
        query = select(func.count()).where(workers.c.heartbeat_at >= time.time() - timeout_s)
        with self._reading() as connection:
            return connection.scalar(query if host is None else query.where(workers.c.host == host)) or 0

    def mark_stopped(self, executor_id: str) -> None:
        """Marks a worker as stopped, for recovery of its jobs without the timeout."""
        with self._writing() as connection:
            connection.execute(update(workers).where(workers.c.executor_id == executor_id).values(heartbeat_at=0.0))

    def take_lease(self, name: str, seconds: float) -> bool:
        """Leases a piece of work that all workers share; False while somebody has it."""
        now = time.time()
        # One that lasts for much longer is of a machine whose clock is ahead.
        over = ~leases.c.until.between(now, now + 2 * seconds)
        with self._writing() as connection:
            return upsert(connection, {leases.c.name: name, leases.c.until: now + seconds}, over)

    def unregister(self, executor_id: str) -> None:
        """Removes a worker without jobs; if it still lives, its next heartbeat registers it again."""
        with self._writing() as connection:
            connection.execute(delete(workers).where(workers.c.executor_id == executor_id))
