"""Whole jobs through a worker process, as a user would post them."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from benchmarks.provenance import ROOT
from fastsplat.service.application.service import open_service
from fastsplat.service.settings import Settings
from fastsplat_contract.jobs.operations import Operation, SceneOptions

_POLL_S = 0.3


@dataclass(frozen=True)
class DoneJob:
    """A job that succeeded: its scene's quality, seconds from its posting to its end, and the machine's load average
    over the last minute when it was posted."""

    quality: Mapping[str, Any]
    seconds: float
    load: float


def run_job(
    files: Mapping[str, bytes],
    options: SceneOptions,
    settings: Settings,
    watch: Callable[[Operation], None] = lambda operation: None,
) -> DoneJob:
    """Post files, by name, to a data folder for which a worker is started, and wait for the scene; `watch` is given the
    job about three times a second. Raises `SystemExit` where the job does not succeed."""
    worker = subprocess.Popen(
        [sys.executable, "-m", "fastsplat.cli.main", "worker"],
        env={**os.environ, "FASTSPLAT_DATA_DIR": str(settings.data_dir)},
        cwd=ROOT,
        start_new_session=True,
    )
    try:
        with open_service(settings) as service:
            with service.new_upload() as upload:
                for name, content in files.items():
                    upload.write(name, [content])
                operation = service.create_scene(upload, "", "", options)
            load, posted = os.getloadavg()[0], time.monotonic()
            while (now := service.get_operation(operation.id)).state in ("QUEUED", "RUNNING"):
                watch(now)
                time.sleep(_POLL_S)
            seconds = time.monotonic() - posted
            if now.state != "SUCCEEDED":
                raise SystemExit(f"the job {now.state}: {now.error}")
            return DoneJob(service.get_scene(operation.scene_id).quality, seconds, load)
    finally:
        worker.terminate()
        worker.wait(timeout=60)
