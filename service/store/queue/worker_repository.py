"""Worker processes and their heartbeats, and leases of what processes on all machines share."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

from sqlalchemy import delete, func, insert, select, update

from fastsplat.service.common.call_scheduling import wait_elsewhere
from fastsplat.service.store.rows.database import Repository, upsert
from fastsplat.service.store.rows.records import WorkerRecord
from fastsplat.service.store.rows.schema import leases, workers
from fastsplat_contract.errors import DatabaseError

_LEASE_POLL_S = 0.02


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

    @contextmanager
    def leased(self, name: str, seconds: float) -> Iterator[bool]:
        """Leases work that all workers share; yields False while somebody has it.

        Nobody else has it during the block, however long that takes, nor `seconds` after it began or was prolonged.
        """
        until, over = self._lease(name, seconds), threading.Event()

        def prolong() -> None:
            ends = [until]  # that were written, or perhaps were not; of three intervals, as older ones are over
            while not over.wait(seconds / 3):
                with suppress(DatabaseError), self._writing() as connection:
                    mine = update(leases).where(leases.c.name == name, leases.c.until.in_(ends))
                    ends = [*ends[-3:], time.time() + seconds]
                    connection.execute(mine.values(until=ends[-1]))

        if until is not None:
            threading.Thread(target=prolong, daemon=True).start()
        try:
            yield until is not None
        finally:
            over.set()

    @contextmanager
    def exclusive(self, name: str, seconds: float) -> Iterator[None]:
        """Leases something for the block, waiting for it; if that takes longer than `seconds`, the next goes on.

        A waiting call gives up its thread if it can be repeated.

        Raises:
            CancelledError, DeadlineExceededError, CallAgainError: as `wait_elsewhere`.
        """
        while (until := self._lease(name, seconds)) is None:
            wait_elsewhere(_LEASE_POLL_S)
        try:
            yield
        finally:
            with suppress(DatabaseError), self._writing() as connection:
                connection.execute(delete(leases).where(leases.c.name == name, leases.c.until == until))

    def _lease(self, name: str, seconds: float) -> float | None:
        """End of a lease in seconds since 1970; None while somebody has it."""
        now = time.time()
        # One that lasts for much longer is of a machine whose clock is ahead.
        held = leases.c.until.between(now, now + 2 * seconds)
        with self._reading() as connection:  # who waits does not take the write lock
            if connection.scalar(select(leases.c.name).where(leases.c.name == name, held)) is not None:
                return None
        with self._writing() as connection:
            row = {leases.c.name: name, leases.c.until: now + seconds}
            return now + seconds if upsert(connection, row, ~held) else None

    def unregister(self, executor_id: str) -> None:
        """Removes a worker without jobs; if it still lives, its next heartbeat registers it again."""
        with self._writing() as connection:
            connection.execute(delete(workers).where(workers.c.executor_id == executor_id))
