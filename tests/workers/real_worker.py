"""A worker with the real stages, which train for a few steps and save after each, and a service beside it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat_contract.operations import Operation

ROOT = Path(__file__).parent.parent.parent
STEPS = 500
TRAINING = TrainingSettings(
    iterations=STEPS, time_budget_s=None, max_gaussians=400, max_side=64, evaluations=0, checkpoint_every_s=0.0
)

# A checkpoint after every step is no setting of a server.
_WORKER = """
import os
from fastsplat.cli.logs import log_to_stderr
from fastsplat.service.settings import load_settings
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.workers.worker_process import run
log_to_stderr("worker")
training = TrainingSettings.model_validate_json(os.environ["TRAINING"])
run(load_settings().model_copy(update={"training": training}))
"""


@pytest.fixture
def service(tmp_path: Path) -> Iterator[SceneService]:
    """A service without a worker."""
    with open_service(Settings(data_dir=tmp_path / "data", training=TRAINING)) as service:
        yield service


@pytest.fixture
def start_worker(service: SceneService, tmp_path: Path) -> Iterator[Callable[[], subprocess.Popen[bytes]]]:
    """Starts a worker of the service's data folder; those that still run at the end are ended."""
    changes = {"poll_interval_s": 0.1, "stalled_worker_timeout_s": 2.0, "niceness": 0}
    environment = {
        **os.environ,
        "FASTSPLAT_DATA_DIR": str(tmp_path / "data"),
        "TRAINING": TRAINING.model_dump_json(),
        "FASTSPLAT_JOBS": json.dumps(changes),
    }
    workers: list[subprocess.Popen[bytes]] = []

    def start() -> subprocess.Popen[bytes]:
        workers.append(
            subprocess.Popen([sys.executable, "-c", _WORKER], env=environment, cwd=ROOT, start_new_session=True)
        )
        return workers[-1]

    yield start
    for worker in workers:
        worker.terminate()
        worker.wait(timeout=60)


def eventually(what: Callable[[], object]) -> None:
    """Wait until something holds, for two minutes."""
    deadline = time.monotonic() + 120
    while not what():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.05)


def over(service: SceneService, operation: Operation) -> Operation:
    """A job once it is over."""
    eventually(lambda: service.get_operation(operation.id).done)
    return service.get_operation(operation.id)
