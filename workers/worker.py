"""The one worker of this process: takes jobs from the engine, runs each under a supervisor, and keeps the house.

Our own rows are the truth about a job: whose attempt it is, how often it was started, how it ended; a stage is done
when its folder is there. The engine queues jobs and knows who runs which. A worker that cannot go on as planned ends
itself: recovery by another, or by itself anew, is the one way back.
"""

from __future__ import annotations

import logging
import os
import socket
import threading
import time
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NoReturn

from fastsplat.service.settings import Settings
from fastsplat.service.store.activity_clock import ActivityClock
from fastsplat.service.store.blobs import PARTIAL_EXPIRY_S
from fastsplat.service.store.claims import FencedError
from fastsplat.service.store.database import resolve_url
from fastsplat.service.store.store import Store
from fastsplat.workers.cleanup import remove_unneeded, trash_lost_scenes, trash_lost_versions
from fastsplat.workers.engine import JobEngine
from fastsplat.workers.heartbeat import Heartbeat, Observer, kill_suspended_workers, prune_stalled_workers
from fastsplat.workers.job_kinds import JobKind
from fastsplat.workers.periodic import repeat
from fastsplat.workers.supervisor import StoppingError, Supervisor
from fastsplat_contract.operations import OperationKind

_CLEANUP_INTERVAL_S = 60.0
"""How often a worker removes folders, uploads, logs and rows that are not needed any more."""

logger = logging.getLogger(__name__)

EXIT_FENCED = 75
"""Exit status of a worker whose job another worker has claimed: start it again (EX_TEMPFAIL)."""
_EXIT_FAILED = 70
_STORAGE_CLEANUP_INTERVAL_S = 3600.0  # it may list a whole object store


@dataclass
class Worker:
    """The one worker of this process: its identity, the job it runs, whether it is stopping."""

    store: Store
    settings: Settings
    kinds: Mapping[OperationKind, JobKind]
    executor_id: str = field(default_factory=lambda: f"{socket.gethostname()}-{os.getpid()}-{uuid.uuid4().hex[:8]}")
    stopping: threading.Event = field(default_factory=threading.Event)
    running: Supervisor | None = None
    heartbeats: Observer = field(default_factory=Observer)
    owners: Observer = field(default_factory=Observer)
    heartbeat: Heartbeat = field(init=False)
    engine: JobEngine = field(init=False)

    def __post_init__(self) -> None:
        self.heartbeat = Heartbeat(self.store, self.executor_id, self.settings.jobs.stalled_worker_timeout_s)


def start(worker: Worker) -> None:
    """Launch the engine in this process and begin to take jobs; returns at once."""
    settings, jobs = worker.settings, worker.settings.jobs
    # Before anything that writes: a suspended worker may hold the lock that a write waits for.
    _repeat(worker, "kill suspended workers", _kill_suspended, jobs.heartbeat_interval_s)
    worker.heartbeat.update()

    def run(operation_id: str, retries: int = 0) -> str:
        return _run(worker, operation_id, retries)

    url = resolve_url(settings.data_dir, settings.database_url, sqlite_name="jobs.sqlite")
    worker.engine = JobEngine(url, worker.executor_id, jobs.poll_interval_s, run)
    _repeat(worker, "enqueue jobs", _enqueue_waiting, jobs.poll_interval_s)
    _repeat(worker, "update heartbeat", lambda worker: worker.heartbeat.update(), jobs.heartbeat_interval_s)
    _repeat(worker, "prune stalled workers", _prune_stalled, jobs.stalled_worker_timeout_s / 2)
    _repeat(worker, "cleanup", _clean_up, _CLEANUP_INTERVAL_S)
    _repeat(worker, "storage cleanup", _clean_up_storage, _STORAGE_CLEANUP_INTERVAL_S)


def stop(worker: Worker, patience_s: float = 15.0) -> None:
    """Give the running job back. The process must end right after: what the engine runs stays pending."""
    worker.stopping.set()
    deadline = time.monotonic() + patience_s
    while worker.running and time.monotonic() < deadline:
        time.sleep(0.05)
    worker.store.workers.mark_stopped(worker.executor_id)


def _run(worker: Worker, operation_id: str, retries: int) -> str:
    """Run one job from claim to end; after a crash again, from the first stage that is not done.

    No exception reaches the engine, which would record it as the end of the job; the job must stay pending.

    Returns:
        How it ended, for the engine's records; "over" if it was cancelled in the queue or had ended before a crash.
    """
    if worker.stopping.is_set():
        _wait_for_exit()
    try:
        claim = worker.store.jobs.claim(operation_id, retries)
        if claim is None:
            return "over"
        kind = worker.kinds[claim.operation.kind]
        worker.running = Supervisor(worker.store, worker.settings, claim, kind, worker.stopping)
        outcome = worker.running.run()
        worker.running = None
        return outcome.state
    except StoppingError:
        worker.running = None
        _wait_for_exit()
    except FencedError:
        logger.warning("job %s has been claimed by another worker; this worker starts over", operation_id)
        _exit_worker(worker, EXIT_FENCED)
    except Exception:
        logger.exception("job %s: the worker cannot go on", operation_id)
        _exit_worker(worker, _EXIT_FAILED)


def _wait_for_exit() -> NoReturn:
    while True:
        time.sleep(3600)


def _exit_worker(worker: Worker, status: int) -> NoReturn:
    if worker.running is not None:
        worker.running.kill()
    logging.shutdown()
    os._exit(status)


def _repeat(worker: Worker, name: str, task: Callable[[Worker], None], interval_s: float) -> None:
    repeat(name, lambda: None if worker.stopping.is_set() else task(worker), interval_s)


def _enqueue_waiting(worker: Worker) -> None:
    # An operation is acknowledged by its row alone; from there it reaches the engine here, once or several times.
    live_since = time.time() - worker.settings.jobs.stalled_worker_timeout_s
    for job in worker.store.jobs.due(live_since):
        worker.engine.enqueue(job)
        worker.store.jobs.mark_enqueued(job.id, job.retries)


def _kill_suspended(worker: Worker) -> None:
    timeout_s = worker.settings.jobs.stalled_worker_timeout_s
    kill_suspended_workers(worker.store, worker.executor_id, worker.heartbeats, timeout_s)


def _prune_stalled(worker: Worker) -> None:
    prune_stalled_workers(
        worker.store,
        worker.engine,
        worker.executor_id,
        worker.heartbeats,
        worker.owners,
        worker.settings.jobs.stalled_worker_timeout_s,
        trust_timeout=worker.heartbeat.is_regular(),
    )


def _clean_up(worker: Worker) -> None:
    settings = worker.settings
    uploads, retention_s = settings.uploads, settings.jobs.ended_job_retention_s
    remove_unneeded(worker.store, uploads.expiry_s, retention_s, uploads.failed_retention_s)
    trash_lost_scenes(worker.store, ActivityClock(worker.store.blobs.root).now())
    worker.engine.forget(time.time() - retention_s)


def _clean_up_storage(worker: Worker) -> None:
    blobs = worker.store.blobs
    blobs.remove_partial(PARTIAL_EXPIRY_S)
    trash_lost_versions(worker.store, min(time.time(), ActivityClock(blobs.root).now()))
