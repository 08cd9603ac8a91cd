"""The worker process: takes jobs until it is told to stop."""

from __future__ import annotations

import logging
import os
import signal
import threading

from fastsplat.service.settings import Settings
from fastsplat.service.store import open_store
from fastsplat.workers.engine import Worker, start, stop

logger = logging.getLogger(__name__)
_STAGES = "fastsplat.workers.stages:DEFAULT_STAGES"


def run(settings: Settings, stages: str = _STAGES) -> None:
    """Work until SIGTERM or SIGINT, then give the running job back and end the process.

    Args:
        settings: where the data is, and how to work.
        stages: "module:name" of the `Stages` that trainers run.
    """
    wanted = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: wanted.set())
    worker = Worker(open_store(settings.data_dir, settings.database_url, settings.artefacts), settings, stages)
    start(worker)
    logger.info("worker %s is ready", worker.executor_id)
    wanted.wait()
    logger.info("worker %s is leaving", worker.executor_id)
    stop(worker)
    logging.shutdown()
    os._exit(0)  # the engine's threads hold unfinished jobs, which must stay pending
