"""Heartbeats of workers, and recovery of the jobs of workers that have stalled.

A worker writes the time into its row. One without a heartbeat for too long is dead, or suspended, or cut off; others
may claim its jobs either way, for each write of a job carries the number of its attempt, and a late write of an old
attempt changes nothing. Of workers of its own machine a worker knows more, and sooner: whether the process has ended.

Who judges measures by its own clock how long it has seen the same heartbeat. Times that others wrote are never compared
with its own: clocks of machines differ, and jump.

A suspended worker may hold locks. On PostgreSQL the server ends its session after a while. On SQLite nothing does: a
process that is stopped in the middle of a transaction keeps every other process of the machine from writing, until it
continues or dies. So every worker kills the stalled workers of its machine that are *stopped*; it needs to read the
database for that, not to write. (A worker that is slow, or held by a debugger, is not stopped.)
"""

from __future__ import annotations

import logging
import os
import signal
import time
from collections.abc import Mapping

from fastsplat.service.store.records import WorkerRecord
from fastsplat.service.store.store import Store
from fastsplat.workers.process_group import machine_id, process_state

logger = logging.getLogger(__name__)


class Heartbeat:
    """This worker's own heartbeat, and whether it has been regular.

    A worker that could not write for a while (the database was away, the machine slept) finds all others without a
    heartbeat, which means nothing until they had time to write theirs again.
    """

    def __init__(self, store: Store, executor_id: str, timeout_s: float) -> None:
        self._store = store
        self._executor_id = executor_id
        self._timeout_s = timeout_s
        self._updated_at = self._regular_since = _seconds()

    def update(self) -> None:
        """Write the heartbeat.

        Raises:
            DatabaseError: the database does not answer.
        """
        self._store.workers.update_heartbeat(self._executor_id, machine_id(), os.getpid())
        now = _seconds()
        if now - self._updated_at > self._timeout_s / 2:
            self._regular_since = now
        self._updated_at = now

    def is_regular(self) -> bool:
        """Whether it has been written often enough for long enough to judge others by theirs."""
        now = _seconds()
        return now - self._updated_at < self._timeout_s / 2 and now - self._regular_since > self._timeout_s


class Observer:
    """Ages of all workers' heartbeats, by how long this process has seen each unchanged. One thread looks; any asks."""

    def __init__(self) -> None:
        self._seen: Mapping[str, tuple[float, float]] = {}

    def look(self, values: Mapping[str, float]) -> None:
        """See what each worker has written last, such as its heartbeat; those that are gone are forgotten."""
        now, before = _seconds(), self._seen
        same = {name: before[name] for name, value in values.items() if name in before and before[name][0] == value}
        self._seen = {name: same.get(name, (value, now)) for name, value in values.items()}

    def stalled(self, timeout_s: float) -> frozenset[str]:
        """Ids of the workers that have written nothing else for `timeout_s` seconds of being looked at."""
        now = _seconds()
        return frozenset(name for name, (_, since) in self._seen.items() if now - since > timeout_s)


def kill_suspended_workers(store: Store, executor_id: str, observer: Observer, timeout_s: float) -> None:
    """Kill the stalled workers of this machine that are stopped; reads the database only.

    Args:
        store: where the heartbeats are.
        executor_id: this worker, which is left out.
        observer: is shown the heartbeats, so that this is to be called often.
        timeout_s: seconds without a heartbeat after which a worker is stalled.
    """
    host, workers = machine_id(), store.workers.list_workers()
    observer.look({worker.executor_id: worker.heartbeat_at for worker in workers})
    stalled = observer.stalled(timeout_s)
    for worker in workers:
        if worker.executor_id == executor_id or worker.host != host or worker.executor_id not in stalled:
            continue
        if process_state(worker.pid, worker.started_at) == "T":
            _kill(worker)


def prune_stalled_workers(
    store: Store, executor_id: str, heartbeats: Observer, owners: Observer, timeout_s: float, *, trust_timeout: bool
) -> None:
    """Let others claim the jobs of dead workers, and unregister dead workers without jobs.

    Args:
        store: where jobs and heartbeats are.
        executor_id: this worker, which is left out.
        heartbeats: what `kill_suspended_workers` has seen.
        owners: what this function has seen of the owners of unfinished jobs.
        timeout_s: seconds without a heartbeat after which a worker is stalled.
        trust_timeout: whether stalled workers are dead, see `Heartbeat.is_regular`; one that has stopped by itself, or
            whose process is known to have ended, is dead in any case.
    """
    # Jobs first, heartbeats second: a worker registers before it takes jobs, so one that is new in between is known.
    busy = store.jobs.owners()
    owners.look(busy)
    host, stalled = machine_id(), heartbeats.stalled(timeout_s)
    others = [worker for worker in store.workers.list_workers() if worker.executor_id != executor_id]
    dead: set[str] = set()
    for worker in others:
        ended = worker.host == host and not process_state(worker.pid, worker.started_at)
        if ended or not worker.heartbeat_at or (trust_timeout and worker.executor_id in stalled):
            dead.add(worker.executor_id)
    if trust_timeout:
        # A worker that was unregistered and lives after all registers soon; jobs without one for longer have none.
        known = {worker.executor_id for worker in others} | {executor_id}
        dead |= owners.stalled(timeout_s) - known
    for dead_id in sorted(dead & set(busy)):
        logger.warning("worker %s is dead; others go on with its jobs", dead_id)
        store.jobs.take_back(dead_id)
    # One that had jobs is unregistered by the next call, which sees that none is left.
    for worker in others:
        if worker.executor_id in dead and worker.executor_id not in busy:
            store.workers.unregister(worker.executor_id)


def _kill(worker: WorkerRecord) -> None:
    try:
        os.kill(worker.pid, signal.SIGKILL)
        logger.warning("worker %s was stopped and without a heartbeat, and has been killed", worker.executor_id)
    except OSError as error:
        logger.warning("worker %s is stopped and cannot be killed: %s", worker.executor_id, error.strerror)


def _seconds() -> float:
    # Unlike the monotonic clock, this one goes on while the machine sleeps.
    return time.clock_gettime(time.CLOCK_BOOTTIME)
