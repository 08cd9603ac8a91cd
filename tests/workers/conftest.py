"""A data folder, a service over it, and real worker processes with fake stages."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest

from service.calls.service import SceneService, open_service
from service.calls.types import Operation, SceneOptions
from service.capture.settings import CaptureSettings
from service.capture.types import AdmittedUpload
from service.settings import JobSettings, Settings

HERE = Path(__file__).parent
_PATIENCE_S = 60.0
_COMMAND = """
from cli.logs import log_to_stderr
from service.settings import load_settings
from workers.main import run
log_to_stderr("worker")
run(load_settings(), "fake_stages:FAKES")
"""


class House:
    """One data folder with a service and the workers that a test starts."""

    def __init__(self, folder: Path, database_url: str) -> None:
        self.settings = Settings(
            data_dir=folder / "data", database_url=database_url, jobs=JobSettings(poll_s=0.1, beat_s=0.3, stale_s=2.0)
        )
        self.max_starts = self.settings.jobs.max_starts
        self.service: SceneService = open_service(self.settings, _admit)
        self._workers: list[subprocess.Popen[bytes]] = []

    def start_worker(self) -> subprocess.Popen[bytes]:
        """A worker process of its own."""
        jobs = self.settings.jobs
        environment = {
            **os.environ,
            "FASTSPLAT_DATA_DIR": str(self.settings.data_dir),
            "FASTSPLAT_DATABASE_URL": self.settings.database_url,
            "FASTSPLAT_JOBS__MAX_STARTS": str(self.max_starts),
            "FASTSPLAT_JOBS__POLL_S": str(jobs.poll_s),
            "FASTSPLAT_JOBS__BEAT_S": str(jobs.beat_s),
            "FASTSPLAT_JOBS__STALE_S": str(jobs.stale_s),
            "PYTHONPATH": os.pathsep.join([str(HERE), str(HERE.parent.parent)]),
        }
        worker = subprocess.Popen([sys.executable, "-c", _COMMAND], env=environment, start_new_session=True)
        self._workers.append(worker)
        return worker

    def post(self, *orders: str, request_id: str = "") -> Operation:
        """A job with orders for the fake stages."""
        with self.service.new_upload() as upload:
            upload.write("images/a.png", [b"picture"])
            return upload.commit("a place", request_id, SceneOptions(labels=orders))

    def state(self, operation: Operation) -> str:
        """Where the job stands."""
        return self.service.get_operation(operation.id).state

    def wait_over(self, operation: Operation) -> Operation:
        """The operation once it has ended."""
        self.wait_for(lambda: self.state(operation) not in ("QUEUED", "RUNNING"))
        return self.service.get_operation(operation.id)

    def visits(self, stage: str) -> list[int]:
        """Process ids of the trainers that entered a stage."""
        path = self.settings.data_dir / "visits.txt"
        lines = path.read_text().split("\n") if path.exists() else []
        return [int(line.split()[2]) for line in lines if line.split()[:1] == [stage]]

    def wait_in(self, stage: str, visit: int = 1) -> int:
        """Process id of the trainer once a stage was entered so often."""
        self.wait_for(lambda: len(self.visits(stage)) >= visit)
        return self.visits(stage)[visit - 1]

    def freeze(self, worker: subprocess.Popen[bytes]) -> None:
        """Stop a worker between two transactions. One that is frozen inside a transaction on SQLite holds the file's
        lock until it wakes or is killed, and nobody else on the machine can write: that is SQLite's, not ours."""

        def frozen() -> bool:
            os.kill(worker.pid, signal.SIGSTOP)
            if all(map(_writable, self.settings.data_dir.glob("*.sqlite"))):
                return True
            os.kill(worker.pid, signal.SIGCONT)
            return False

        self.wait_for(frozen)

    def left_over(self) -> list[str]:
        """Everything on disk that belongs to jobs and uploads."""
        folders = [self.settings.data_dir / name for name in ("jobs", "uploads")]
        return sorted(path.name for folder in folders if folder.is_dir() for path in folder.iterdir())

    @staticmethod
    def wait_for(what: Callable[[], object]) -> None:
        """Return once `what()` is true; fail the test if it never is."""
        deadline = time.monotonic() + _PATIENCE_S
        while not what():
            assert time.monotonic() < deadline, "waited in vain"
            time.sleep(0.05)

    @staticmethod
    def is_alive(pid: int) -> bool:
        """Whether a process runs (a zombie does not)."""
        try:
            return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] not in ("Z", "X")
        except FileNotFoundError:
            return False

    def close(self) -> None:
        """Kill what still runs."""
        for worker in self._workers:
            if worker.poll() is None:
                os.kill(worker.pid, signal.SIGCONT)
                worker.kill()
            worker.wait()
        self.service.close()


def _admit(folder: Path, settings: CaptureSettings) -> AdmittedUpload:
    return AdmittedUpload(folder, "images", sum(1 for path in folder.rglob("*") if path.is_file()))


@pytest.fixture
def house(tmp_path: Path, database_url: str) -> Iterator[House]:
    """A fresh data folder; its workers are gone when the test ends."""
    house = House(tmp_path, database_url)
    yield house
    house.close()


def _writable(database: Path) -> bool:
    with closing(sqlite3.connect(database, timeout=0.5, isolation_level=None)) as connection:
        try:
            connection.execute("BEGIN IMMEDIATE")
        except sqlite3.OperationalError:
            return False
        connection.execute("ROLLBACK")
        return True
