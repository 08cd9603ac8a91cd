"""A worker's process, with the launcher that the settings name."""

from __future__ import annotations

import logging
import os
import signal
import threading
from collections.abc import Mapping

from fastsplat.service.common.optional_packages import RAY, needed
from fastsplat.service.jobs.needed_models import in_use, log_missing_models
from fastsplat.service.settings import Settings
from fastsplat.workers.engine.worker import Launcher, open_worker, run_here, start, stop, wait_for_space
from fastsplat.workers.kinds.job_kinds import KINDS, JobKind
from fastsplat_contract.jobs.operations import OperationKind

logger = logging.getLogger(__name__)


def run(settings: Settings, kinds: Mapping[OperationKind, JobKind] = KINDS) -> None:
    """Has jobs run until SIGTERM or SIGINT, then returns the job that runs here and exits.

    Raises:
        MissingPackageError: Ray is to run them and is not installed.
    """
    launcher: Launcher = run_here
    if settings.jobs.launcher == "ray":
        with needed(RAY, "the launcher ray", field="jobs.launcher", where="on every machine of the cluster"):
            from fastsplat.workers.engine.ray_cluster import RayCluster
        launcher = RayCluster()
    stop_requested = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop_requested.set())
    wait_for_space(settings.data_dir, stop_requested.wait)
    worker = open_worker(settings, kinds)
    start(worker, launcher)
    log_missing_models(in_use(settings, worker.store.models.chosen()))
    logger.info("worker %s is ready", worker.executor_id)
    stop_requested.wait()
    logger.info("worker %s is stopping", worker.executor_id)
    stop(worker)
    logging.shutdown()
    os._exit(0)  # without waiting for threads: none may begin a job any more
