"""A process's worker: has waiting jobs run by its launcher, and does periodic maintenance.

The database is the queue: attempt, owner, starts and outcome of a job; a stage is done when its folder exists. A worker
in an unexpected state exits: the only recovery is by another worker or a restart.
"""

from __future__ import annotations

import logging
import os
import shutil
import socket
import threading
import time
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NoReturn, Protocol

from fastsplat.service.common.process import machine_bytes
from fastsplat.service.common.setting_groups import ModelChoice
from fastsplat.service.jobs.needed_models import in_use, lacking
from fastsplat.service.settings import Settings
from fastsplat.service.store.blobs.activity_clock import ActivityClock
from fastsplat.service.store.blobs.blobs import PARTIAL_EXPIRY_S
from fastsplat.service.store.queue.claims import Claim, FencedError
from fastsplat.service.store.store import Store, open_store
from fastsplat.workers.engine.cleanup import remove_unneeded, trash_lost_scenes, trash_lost_versions
from fastsplat.workers.engine.heartbeat import Heartbeats
from fastsplat.workers.engine.periodic import RepeatFilter, repeat
from fastsplat.workers.engine.supervisor import ReturnedError, Supervisor
from fastsplat.workers.kinds.job_kinds import JobKind
from fastsplat_contract.jobs.operations import OperationKind

logger = logging.getLogger(__name__)
logger.addFilter(RepeatFilter(interval_s=3600.0, length=200))

EXIT_FENCED = 75
"""Exit status after losing a job to another worker; restart it (EX_TEMPFAIL)."""
_EXIT_FAILED = 70
_CLEANUP_INTERVAL_S = 30.0  # of folders, uploads, logs and rows
_STORAGE_CLEANUP_INTERVAL_S = 3600.0  # it may list a whole object store
_MARGIN_S = 15.0  # by which a cleanup bars its worker's next one, so that each machine comes to clean its folder

_ROWS_BYTES = 1 << 20
_FULL_PAUSE_S = 5.0


@dataclass
class Worker:
    """The process's worker: identity, running job, stop flag."""

    store: Store
    settings: Settings
    kinds: Mapping[OperationKind, JobKind]
    executor_id: str = field(default_factory=lambda: f"{socket.gethostname()}-{os.getpid()}-{uuid.uuid4().hex[:8]}")
    stopping: threading.Event = field(default_factory=threading.Event)
    running: Supervisor | None = None
    heartbeats: Heartbeats = field(init=False)

    def __post_init__(self) -> None:
        self.heartbeats = Heartbeats(self.store, self.executor_id, self.settings.jobs.stalled_worker_timeout_s)


class Launcher(Protocol):
    """Starts waiting jobs where there is room, in this process or elsewhere; called at each poll.

    Where a job runs, a `Worker` claims it once it has what the job needs, and a `Supervisor` has the trainer as a child
    process, by the settings of that machine. All else crosses machines through the store: claims, progress, requests
    and results of photos in rows; uploads, drafts, progress files, finished stages, versions and logs in `Blobs`.
    """

    def __call__(self, worker: Worker) -> None: ...


def open_worker(settings: Settings, kinds: Mapping[OperationKind, JobKind]) -> Worker:
    """Opens the store for a new worker; raises as `open_store`."""
    return Worker(open_store(settings.data_dir, settings.database_url, settings.artefacts), settings, kinds)


def start(worker: Worker, launcher: Launcher) -> None:
    """Registers the worker, starts its threads and returns."""
    jobs, heartbeats = worker.settings.jobs, worker.heartbeats
    # Before any write: a suspended worker may hold the lock it would wait for.
    _repeat(worker, "kill suspended workers", heartbeats.kill_suspended, jobs.heartbeat_interval_s)
    heartbeats.update()
    _repeat(worker, "update heartbeat", heartbeats.update, jobs.heartbeat_interval_s)
    _repeat(worker, "run jobs", partial(launcher, worker), jobs.poll_interval_s)
    _repeat(worker, "prune stalled workers", heartbeats.prune_stalled, jobs.stalled_worker_timeout_s / 2)
    _repeat(worker, "cleanup", partial(_clean_up, worker), _CLEANUP_INTERVAL_S)


def stop(worker: Worker, patience_s: float = 15.0) -> None:
    """Stops claiming and returns the running job; the process must exit right after."""
    worker.stopping.set()
    deadline = time.monotonic() + patience_s
    while worker.running and time.monotonic() < deadline:
        time.sleep(0.05)
    worker.store.workers.mark_stopped(worker.executor_id)


def run_here(worker: Worker) -> None:
    """The launcher that runs jobs in this process, one by one."""
    while not worker.stopping.is_set() and run_next(worker):
        pass


def run_next(worker: Worker, operation_id: str = "") -> bool:
    """Runs the first job in turn, or the one of an id, to its end; False if no worker like this may claim it now."""
    models, queue = worker.store.models.chosen(), worker.store.jobs
    has_gpu = worker.settings.training.backend == "cuda" and os.environ.get("CUDA_VISIBLE_DEVICES") != ""
    offer: Mapping[str, Any] = {"gpus": int(has_gpu), "memory": machine_bytes(), "only": operation_id}
    claim = queue.claim_next(worker.executor_id, models, partial(_can_use, worker), **offer)
    if claim is not None:
        _run(worker, claim)
    return claim is not None


def _can_use(worker: Worker, choice: ModelChoice) -> bool:
    """True if the models of a choice are on this machine; says which are not."""
    if missing := lacking(worker.settings, choice):
        names, folder = ", ".join(missing), worker.settings.models
        logger.warning("jobs with %s are left to other workers: not in %s; pull the models there", names, folder)
    return not missing


def _run(worker: Worker, claim: Claim) -> None:
    """Runs a job to its end, starting at the first missing stage; exits the process if the job was lost."""
    job = claim.operation
    try:
        settings = in_use(worker.settings, job.models)
        worker.running = Supervisor(worker.store, settings, claim, worker.kinds[job.kind], worker.stopping)
        worker.running.run()
    except ReturnedError:
        pass
    except FencedError:
        logger.warning("job %s has been claimed by another worker; this worker starts over", job.id)
        _exit_worker(worker, EXIT_FENCED)
    except Exception:
        logger.exception("job %s: the worker cannot go on", job.id)
        _exit_worker(worker, _EXIT_FAILED)
    worker.running = None


def _exit_worker(worker: Worker, status: int) -> NoReturn:
    if worker.running is not None:
        worker.running.kill()
    logging.shutdown()
    os._exit(status)


def _repeat(worker: Worker, name: str, task: Callable[[], None], interval_s: float) -> None:
    repeat(name, lambda: None if worker.stopping.is_set() else task(), interval_s)


def _clean_up(worker: Worker) -> None:
    store, settings, now = worker.store, worker.settings, ActivityClock(worker.store.blobs.root).now()
    with store.workers.leased("cleanup", _CLEANUP_INTERVAL_S + _MARGIN_S) as mine:
        if mine:
            uploads, retention_s = settings.uploads, settings.jobs.ended_job_retention_s
            remove_unneeded(store, uploads.expiry_s, retention_s, uploads.failed_retention_s)
    with store.workers.leased("storage cleanup", _STORAGE_CLEANUP_INTERVAL_S + _MARGIN_S) as mine:
        if mine:
            store.blobs.remove_partial(PARTIAL_EXPIRY_S)
            trash_lost_scenes(store, now)
            trash_lost_versions(store, min(time.time(), now))


def wait_for_space(data_dir: Path, pause: Callable[[float], bool]) -> None:
    """Waits until the disk has room for a worker's rows, or `pause` returns True.

    A worker that exited instead would be restarted until its supervisor gave up on all.
    """
    while data_dir.is_dir() and shutil.disk_usage(data_dir).free < _ROWS_BYTES:
        logger.warning("the disk of the data folder is full; this worker waits for space")
        if pause(_FULL_PAUSE_S):
            return
