"""Who is alive, and what becomes of the work of those who are not.

A worker beats: it writes the time into its row. One that is silent for too long is dead, or frozen, or cut off; its
jobs are queued again either way, for each write of a job carries the number of its attempt, and an old one changes
nothing. Of workers of its own machine a sweeper knows more, and sooner: whether the process is over.

A frozen worker may hold locks. On PostgreSQL the server ends its session after a while. On SQLite nobody can: a process
that is stopped in the middle of a transaction keeps every other process of the machine from writing, until it wakes or
dies. So whoever sweeps kills silent workers of its own machine that are *stopped*; it needs to read the database for
that, not to write. (A worker that is slow, or held by a debugger, is not stopped.)
"""

from __future__ import annotations

import logging
import os
import signal
import time
from collections.abc import Mapping

from dbos import DBOS

from fastsplat.service.store import Store
from fastsplat.service.store.records import WorkerRecord
from fastsplat.workers.lifeline import machine, process_state

logger = logging.getLogger(__name__)


class Pulse:
    """This worker's own beat, and how long it has been steady.

    Whoever could not beat for a while (the database was away, the machine slept) finds everybody silent and knows
    nothing: it must not judge before the others had time to beat again.
    """

    def __init__(self, store: Store, executor_id: str, stale_s: float) -> None:
        self._store = store
        self._executor_id = executor_id
        self._stale_s = stale_s
        self._beat_at = self._steady_since = _seconds()

    def beat(self) -> None:
        """Say that this worker lives."""
        self._store.jobs.beat(self._executor_id, machine(), os.getpid())
        now = _seconds()
        if now - self._beat_at > self._stale_s / 2:
            self._steady_since = now
        self._beat_at = now

    def may_judge(self) -> bool:
        """Whether silence of others means something."""
        now = _seconds()
        return now - self._beat_at < self._stale_s / 2 and now - self._steady_since > self._stale_s


def kill_frozen(store: Store, executor_id: str, stale_s: float) -> None:
    """Kill the silent workers of this machine that are stopped; reads the database only."""
    here, now = machine(), time.time()
    for worker in store.jobs.workers():
        if worker.executor_id == executor_id or worker.host != here or not worker.silent(stale_s, now):
            continue
        if process_state(worker.pid, worker.started_at) == "T":
            _kill(worker)


def sweep(store: Store, executor_id: str, stale_s: float, *, judge: bool) -> None:
    """Queue the work of the dead again.

    Args:
        store: where the beats are.
        executor_id: who sweeps.
        stale_s: seconds of silence that mean death.
        judge: whether silence means something, see `Pulse.may_judge`; who has resigned, or is known to be over, is
            dead in any case.
    """
    # Work first, beats second: a worker beats before it takes work, so one that is new in between is known.
    busy = _busy_since()
    here, now = machine(), time.time()
    others = [worker for worker in store.jobs.workers() if worker.executor_id != executor_id]
    dead: set[str] = set()
    for worker in others:
        over = worker.host == here and not process_state(worker.pid, worker.started_at)
        if over or not worker.beat_at or (judge and worker.silent(stale_s, now)):
            dead.add(worker.executor_id)
    if judge:
        # A worker that was buried and comes back beats soon; work that nobody owns for longer is lost.
        known = {worker.executor_id for worker in others} | {executor_id}
        dead |= {owner for owner, since in busy.items() if owner not in known and since < now - stale_s}
    for dead_id in sorted(dead & set(busy)):
        logger.warning("worker %s is gone; its jobs are queued again", dead_id)
        DBOS._recover_pending_workflows([dead_id])
    # One that had work is buried by the next sweep, which sees that none is left.
    for worker in others:
        if worker.executor_id in dead and worker.executor_id not in busy:
            store.jobs.bury(worker.executor_id)


def _busy_since() -> Mapping[str, float]:
    """When the owners of running work last took some, in seconds since 1970."""
    running = DBOS.list_workflows(status="PENDING", load_input=False, load_output=False)
    busy: dict[str, float] = {}
    for workflow in running:
        if workflow.executor_id:
            taken = (workflow.updated_at or 0) / 1000
            busy[workflow.executor_id] = max(taken, busy.get(workflow.executor_id, 0.0))
    return busy


def _kill(worker: WorkerRecord) -> None:
    try:
        os.kill(worker.pid, signal.SIGKILL)
        logger.warning("worker %s was stopped and silent, and has been killed", worker.executor_id)
    except OSError as error:
        logger.warning("worker %s is stopped and cannot be killed: %s", worker.executor_id, error.strerror)


def _seconds() -> float:
    # Unlike the monotonic clock, this one goes on while the machine sleeps.
    return time.clock_gettime(time.CLOCK_BOOTTIME)
