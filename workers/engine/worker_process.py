"""Worker process: runs jobs until SIGTERM or SIGINT."""

from __future__ import annotations

import logging
import os
import shutil
import signal
import threading
from collections.abc import Callable, Mapping
from pathlib import Path

from fastsplat.service.jobs.needed_models import log_missing_models
from fastsplat.service.settings import Settings
from fastsplat.service.store.store import open_store
from fastsplat.workers.engine.worker import Worker, start, stop
from fastsplat.workers.kinds.job_kinds import KINDS, JobKind
from fastsplat_contract.jobs.operations import OperationKind

logger = logging.getLogger(__name__)
_ROWS_BYTES = 1 << 20
_FULL_PAUSE_S = 5.0


def run(settings: Settings, kinds: Mapping[OperationKind, JobKind] = KINDS) -> None:
    """Runs jobs until SIGTERM or SIGINT, then returns the running job and exits."""
    stop_requested = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop_requested.set())
    wait_for_space(settings.data_dir, stop_requested.wait)
    worker = Worker(open_store(settings.data_dir, settings.database_url, settings.artefacts), settings, kinds)
    start(worker)
    log_missing_models(settings)
    logger.info("worker %s is ready", worker.executor_id)
    stop_requested.wait()
    logger.info("worker %s is stopping", worker.executor_id)
    stop(worker)
    logging.shutdown()
    os._exit(0)  # without waiting for threads: none may begin a job any more


def wait_for_space(data_dir: Path, pause: Callable[[float], bool]) -> None:
    """Waits until the disk has room for a worker's rows, or `pause` returns True.

    A worker that exited instead would be restarted until its supervisor gave up on all.
    """
    while data_dir.is_dir() and shutil.disk_usage(data_dir).free < _ROWS_BYTES:
        logger.warning("the disk of the data folder is full; this worker waits for space")
        if pause(_FULL_PAUSE_S):
            return
