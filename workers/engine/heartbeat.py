"""Heartbeats of workers and recovery of jobs of stalled workers.

A worker without a heartbeat for too long is dead, suspended or cut off. Others may claim its jobs in any case: each
write carries the attempt's number, so late writes of an old attempt have no effect. On its own machine a worker also
sees if a process has ended.

An observer measures with its own clock how long a heartbeat has been unchanged, since clocks of machines differ and
jump.

A suspended worker may hold locks. PostgreSQL ends its session after a while. SQLite does not: a process stopped within
a transaction blocks all writers of the machine. So every worker kills stalled workers of its machine that are *stopped*
(state T, not slow or being debugged), for which it only reads the database.
"""

from __future__ import annotations

import logging
import os
import signal
import time
from collections.abc import Mapping

from fastsplat.service.store.store import Store
from fastsplat.workers.engine.process_group import machine_id, process_state

logger = logging.getLogger(__name__)


class Observer:
    """Measures how long other workers' values stay unchanged; one thread looks, any reads."""

    def __init__(self) -> None:
        self._seen: Mapping[str, tuple[float, float]] = {}

    def look(self, values: Mapping[str, float]) -> None:
        """Records each worker's latest value; forgets workers that are gone."""
        now, before = _seconds(), self._seen
        same = {name: before[name] for name, value in values.items() if name in before and before[name][0] == value}
        self._seen = {name: same.get(name, (value, now)) for name, value in values.items()}

    def stalled(self, timeout_s: float) -> frozenset[str]:
        """Ids of workers whose value has been unchanged for `timeout_s` seconds."""
        now = _seconds()
        return frozenset(name for name, (_, since) in self._seen.items() if now - since > timeout_s)


class Heartbeats:
    """This worker's heartbeat, and those of all workers as it observes them; its methods may raise `DatabaseError`.

    After an outage of the database or machine sleep all other workers appear stalled until they had time to write
    again.
    """

    def __init__(self, store: Store, executor_id: str, timeout_s: float) -> None:
        self._store = store
        self._executor_id = executor_id
        self._timeout_s = timeout_s
        self._updated_at = self._regular_since = _seconds()
        self._workers, self._owners = Observer(), Observer()

    def update(self) -> None:
        """Writes the heartbeat."""
        self._store.workers.update_heartbeat(self._executor_id, machine_id(), os.getpid())
        now = _seconds()
        if now - self._updated_at > self._timeout_s / 2:
            self._regular_since = now
        self._updated_at = now

    def kill_suspended(self) -> None:
        """Kills stalled workers of this machine that are stopped; only reads the database. To be called often."""
        host, workers = machine_id(), self._store.workers.list_workers()
        self._workers.look({worker.executor_id: worker.heartbeat_at for worker in workers})
        stalled = self._workers.stalled(self._timeout_s) - {self._executor_id}
        for worker in workers:
            is_stalled = worker.host == host and worker.executor_id in stalled
            if not is_stalled or process_state(worker.pid, worker.started_at) != "T":
                continue
            try:
                os.kill(worker.pid, signal.SIGKILL)
                logger.warning("worker %s was stopped and without a heartbeat, and has been killed", worker.executor_id)
            except OSError as error:
                logger.warning("worker %s is stopped and cannot be killed: %s", worker.executor_id, error.strerror)

    def prune_stalled(self) -> None:
        """Releases the jobs of dead workers, and unregisters dead workers without jobs.

        Stopped workers and ended processes are dead; stalled ones if this heartbeat has been regular for long enough.
        """
        # Jobs before heartbeats: workers register before they claim, so one that starts in between is known.
        busy = self._store.jobs.owners()
        self._owners.look(busy)
        host, stalled, now = machine_id(), self._workers.stalled(self._timeout_s), _seconds()
        regular = now - self._updated_at < self._timeout_s / 2 and now - self._regular_since > self._timeout_s
        workers = [worker for worker in self._store.workers.list_workers() if worker.executor_id != self._executor_id]
        dead: set[str] = set()
        for worker in workers:
            ended = worker.host == host and not process_state(worker.pid, worker.started_at)
            if ended or not worker.heartbeat_at or (regular and worker.executor_id in stalled):
                dead.add(worker.executor_id)
        if regular:
            # A live worker that was unregistered registers again soon; owners that stay unknown are dead.
            known = {worker.executor_id for worker in workers} | {self._executor_id}
            dead |= self._owners.stalled(self._timeout_s) - known
        for dead_id in sorted(dead & set(busy)):
            logger.warning("worker %s is dead; others go on with its jobs", dead_id)
            self._store.jobs.take_back(dead_id)
        # Workers that had jobs are unregistered by the next call, once none is left.
        for worker in workers:
            if worker.executor_id in dead and worker.executor_id not in busy:
                self._store.workers.unregister(worker.executor_id)


def _seconds() -> float:
    # Unlike the monotonic clock, this one advances while the machine sleeps.
    return time.clock_gettime(time.CLOCK_BOOTTIME)
