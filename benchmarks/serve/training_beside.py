"""A real worker that trains the sample capture beside what is measured, on the same cores."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from benchmarks.provenance import ROOT
from benchmarks.serve.api_process import Api
from fastsplat.service.settings import Settings
from fastsplat_client import Client


@contextmanager
def training_beside(api: Api, settings: Settings, *, wanted: bool) -> Iterator[Callable[[], bool]]:
    """A worker that trains the sample capture, from its first training step on, until the block ends.

    Yields what says whether it still trains.

    Raises:
        RuntimeError: the training ended before its first step.
    """
    if not wanted:
        yield lambda: False
        return
    environment = {**os.environ, "FASTSPLAT_DATA_DIR": str(settings.data_dir), "FASTSPLAT_MODELS": str(settings.models)}
    environment["FASTSPLAT_TRAINING__TIME_BUDGET_S"] = "3600"
    log = (settings.data_dir.parent / "worker.log").open("ab")
    command = [sys.executable, "-m", "fastsplat.cli.main", "worker"]
    worker = subprocess.Popen(command, env=environment, stdout=log, stderr=log)
    try:
        with Client(f"http://127.0.0.1:{api.http_port}", key=api.key, timeout_s=120) as client:
            operation = client.create_scene(ROOT / "demo/sample/images")
            while not any(stage.stage == "training" and stage.fraction > 0 for stage in operation.stages):
                if operation.done:
                    raise RuntimeError(f"the training beside ended: {operation.error}")
                time.sleep(1.0)
                operation = client.operation(operation.id)
            yield lambda: not client.operation(operation.id).done
    finally:
        worker.terminate()
        worker.wait(60)
        log.close()
