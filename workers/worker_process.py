"""The worker process: takes jobs until SIGTERM or SIGINT."""

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
    stop_requested = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop_requested.set())
    worker = Worker(open_store(settings.data_dir, settings.database_url, settings.artefacts), settings, stages)
    start(worker)
    logger.info("worker %s is ready", worker.executor_id)
    stop_requested.wait()
    logger.info("worker %s is stopping", worker.executor_id)
    stop(worker)
    logging.shutdown()
    os._exit(0)  # the engine's threads hold unfinished jobs, which must stay pending
