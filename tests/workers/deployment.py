"""A data folder, a service over it, and real processes around it: workers with fake stages, and the API."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx
import psycopg
import pytest

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import ValidatedUpload
from fastsplat.service.common.setting_groups import settings_of
from fastsplat.service.settings import JobSettings, Settings
from fastsplat.workers.kinds.job_kinds import KINDS
from fastsplat_contract.jobs.operations import Operation, SceneOptions
from release.check_wheels import free_ports
from tests.api.uploaded import photo
from tests.postgres import PostgresServer
from tests.processes import is_alive, process_file
from tests.scenes import stand_in_models
from tests.waiting import wait_for
from tests.workers.standby import APIS, WORKERS
from tests.workers.watched_sockets import watching

STAGES = KINDS["create_scene"].stages
_HERE = Path(__file__).parent
_PATIENCE_S = 120.0
_PHOTOS = [photo(seed, (64, 64)) for seed in range(3)]
_WORKER = """
from dataclasses import replace
import fastsplat.workers.engine.heartbeat
from fastsplat.service.common.process import die_with_named_parent
die_with_named_parent()
from fastsplat.cli.operating.logs import log_to_stderr
from fastsplat.service.settings import load_settings
from fastsplat.workers.kinds.job_kinds import KINDS
from fastsplat.workers.engine.launchers import run
if {elsewhere}:
    fastsplat.workers.engine.heartbeat.machine_id = lambda: "another machine"
log_to_stderr("worker")
run(load_settings(), {{name: replace(kind, run="fake_stages:FAKES") for name, kind in KINDS.items()}})
"""
_API = """
import sys
from fastsplat.cli.main import main
sys.argv = ["fastsplat", "api"]
main()
"""


def post_folder(service: SceneService, folder: Path, options: SceneOptions, name: str = "") -> Operation:
    with service.new_upload() as upload:
        for path in sorted(path for path in folder.rglob("*") if path.is_file()):
            with path.open("rb") as file:
                upload.write(path.relative_to(folder).as_posix(), file)
        return service.create_scene(upload, name, "", options)


def on_both_databases(fixture: str = "deployment") -> pytest.MarkDecorator:
    """Runs a test on PostgreSQL as well: for laws whose SQL or locking differs there."""
    return pytest.mark.parametrize(fixture, ["sqlite", "postgresql"], indirect=True)


def new_database(request: pytest.FixtureRequest, opened: ExitStack, database: str = "") -> str:
    """URL of a new database, which goes with `opened`; "" for SQLite in the data folder."""
    if (database or getattr(request, "param", "sqlite")) == "sqlite":
        return ""
    server: PostgresServer = request.getfixturevalue("postgres")
    return opened.enter_context(server.database())


@contextmanager
def real_worker(settings: Settings, *watched: Path, **variables: str) -> Iterator[subprocess.Popen[bytes]]:
    """`fastsplat worker` with its real stages until the block ends; of `variables` FASTSPLAT_ is left out."""
    environment = {
        **os.environ,
        "FASTSPLAT_DATA_DIR": str(settings.data_dir),
        "FASTSPLAT_MODELS": str(settings.models),
        "FASTSPLAT_JOBS": '{"niceness": 0}',
        **{f"FASTSPLAT_{name}": value for name, value in variables.items()},
    }
    for folder in watched:
        environment = watching(folder, environment)
    command = [sys.executable, "-m", "fastsplat.cli.main", "worker"]
    worker = subprocess.Popen(command, env=environment, cwd=_HERE.parent.parent, start_new_session=True)
    try:
        yield worker
    finally:
        worker.terminate()
        assert worker.wait(timeout=60) == 0


def wait_over(service: SceneService, operation: Operation, patience_s: float = 300.0) -> Operation:
    wait_for(lambda: service.get_operation(operation.id).done, patience_s)
    return service.get_operation(operation.id)


@dataclass(frozen=True)
class Visit:
    """A trainer entered a stage."""

    stage: str
    operation_id: str
    attempt: int
    pid: int


class Deployment:
    """One data folder with a service and the processes that a test starts."""

    def __init__(self, folder: Path, database_url: str, **changes: object) -> None:
        jobs = JobSettings(poll_interval_s=0.1, stalled_worker_timeout_s=3.0, niceness=1)
        models = stand_in_models(changes.pop("models", folder / "models"), "minilm_l6_int8")
        self.settings = Settings(
            data_dir=folder / "data", models=models, database_url=database_url, jobs=jobs, auth="off", **changes
        )
        self.max_starts = jobs.max_starts
        self.service: SceneService = open_service(self.settings, admit)
        self.http = f"http://127.0.0.1:{free_ports(1)[0]}"
        self._processes: list[subprocess.Popen[bytes]] = []

    def start_worker(
        self, *, elsewhere: bool = False, max_file: int = 0, code: str = "", data_dir: Path | None = None, **more: str
    ) -> subprocess.Popen[bytes]:
        variables = {**more, **({"FASTSPLAT_DATA_DIR": str(data_dir)} if data_dir else {})}
        code += self.worker_code(elsewhere=elsewhere)
        worker = WORKERS.run(code, {**self.environment(), **variables}, max_file)
        self._processes.append(worker)
        return worker

    @staticmethod
    def worker_code(*, elsewhere: bool = False) -> str:
        return _WORKER.format(elsewhere=elsewhere)

    def start_api(self, *, wait: bool = True) -> subprocess.Popen[bytes]:
        """`fastsplat api`, once it answers at `http`."""
        # Never opened: labels are orders here.
        api = APIS.run(_API, {**self.environment(), "FASTSPLAT_PERCEPTION__OPEN_SET_DETECTOR": "grounding_dino_tiny"})
        self._processes.append(api)
        if wait:
            self.wait_for(lambda: answers(f"{self.http}/livez"))
        return api

    def environment(self) -> dict[str, str]:
        jobs = self.settings.jobs
        return {
            **os.environ,
            "FASTSPLAT_DATA_DIR": str(self.settings.data_dir),
            "FASTSPLAT_MODELS": str(self.settings.models),
            "FASTSPLAT_DATABASE_URL": self.settings.database_url,
            "FASTSPLAT_ARTEFACTS__URL": self.settings.artefacts.url,
            "FASTSPLAT_ARTEFACTS__ENDPOINT_URL": self.settings.artefacts.endpoint_url,
            "FASTSPLAT_AUTH": "off",
            "FASTSPLAT_HTTP_PORT": self.http.rsplit(":", 1)[1],
            "FASTSPLAT_GRPC_PORT": "0",
            "FASTSPLAT_METRICS_PORT": "0",
            "FASTSPLAT_JOBS": jobs.model_copy(update={"max_starts": self.max_starts}).model_dump_json(
                include=set(settings_of(JobSettings))
            ),
            "PYTHONPATH": os.pathsep.join([str(_HERE), str(_HERE.parent.parent)]),
        }

    def post(
        self, *orders: str, request_id: str = "", priority: int = 0, service: SceneService | None = None
    ) -> Operation:
        """A job with orders for the fake stages, in a service's project."""
        service, options = service or self.service, SceneOptions(labels=orders, priority=priority)
        with service.new_upload() as upload:
            upload.write("images/a.png", [b"picture"])
            return service.create_scene(upload, "a place", request_id, options)

    def post_over_http(self, *orders: str, request_id: str = "") -> str:
        """The same through the API process; returns the operation's id once that has acknowledged it."""
        reply = httpx.post(
            f"{self.http}/v1/scenes",
            data={"labels": list(orders), "request_id": request_id},
            files=[("images", (f"{number}.jpg", picture)) for number, picture in enumerate(_PHOTOS)],
            timeout=_PATIENCE_S,
        )
        reply.raise_for_status()
        return str(reply.json()["id"])

    def state(self, operation: Operation) -> str:
        return self.service.get_operation(operation.id).state

    def wait_over(self, operation: Operation) -> Operation:
        return wait_over(self.service, operation, _PATIENCE_S)

    def visits(self, stage: str, operation: Operation | None = None, data_dir: Path | None = None) -> list[Visit]:
        """Who entered a stage, in this order, for one job or for all."""
        path = (data_dir or self.settings.data_dir) / "visits.txt"
        lines = [line.split() for line in path.read_text().splitlines()] if path.exists() else []
        visits = [Visit(line[0], line[1], int(line[2]), int(line[3])) for line in lines]
        wanted = {operation.id} if operation else {visit.operation_id for visit in visits}
        return [visit for visit in visits if visit.stage == stage and visit.operation_id in wanted]

    def wait_in(self, stage: str, operation: Operation, visit: int = 1) -> int:
        """Process id of the trainer once it entered a stage of a job for the nth time."""
        self.wait_for(lambda: len(self.visits(stage, operation)) >= visit)
        return self.visits(stage, operation)[visit - 1].pid

    def suspend(self, worker: subprocess.Popen[bytes]) -> None:
        """Stop a worker between two transactions."""

        def is_suspended() -> bool:
            os.kill(worker.pid, signal.SIGSTOP)
            self.wait_for(lambda: _all_threads_stopped(worker.pid))  # until then one of them may begin to write
            url = self.settings.database_url
            if _at_rest(url) if url else all(map(_writable, self.settings.data_dir.glob("*.sqlite"))):
                return True
            os.kill(worker.pid, signal.SIGCONT)
            return False

        self.wait_for(is_suspended)

    def left_over(self, *of: Operation) -> list[str]:
        """Everything on disk that belongs to jobs and uploads: of these, or of all."""
        folders = [self.settings.data_dir / name for name in ("jobs", "uploads")]
        names = sorted(path.name for folder in folders if folder.is_dir() for path in folder.iterdir())
        records = [self.service._store.scenes.operation(operation.id) for operation in of]
        wanted = {name for record in records for name in (record.id, record.upload_id)}
        return [name for name in names if not of or name in wanted]

    def uploads_of(self, *of: Operation) -> list[str]:
        return sorted(self.service._store.scenes.operation(operation.id).upload_id for operation in of)

    wait_for = staticmethod(wait_for)
    is_alive = staticmethod(is_alive)

    def close(self) -> None:
        """Kill what still runs."""
        for process in self._processes:
            if process.poll() is None:
                os.kill(process.pid, signal.SIGCONT)
                process.kill()
            process.wait()
        self.service.close()

    def start_command(self, command: list[str], **environment: str) -> subprocess.Popen[bytes]:
        process = subprocess.Popen(command, env={**self.environment(), **environment}, start_new_session=True)
        self._processes.append(process)
        return process


def children(parent: int) -> list[int]:
    """Ids of the processes that one has started itself."""
    threads = Path(f"/proc/{parent}/task").glob("*/children")
    return [int(pid) for path in threads for pid in process_file(path).split()]


def kill(*processes: subprocess.Popen[bytes]) -> None:
    """kill -9, all at once."""
    for process in processes:
        process.kill()
    for process in processes:
        process.wait()


def admit(folder: Path, settings: CaptureSettings, strict: bool) -> ValidatedUpload:
    count = sum(1 for path in folder.rglob("*") if path.is_file())
    return ValidatedUpload(folder, "images", count, has_labels=True)  # labels are orders here


def answers(url: str) -> bool:
    try:
        return httpx.get(url, timeout=5).is_success
    except httpx.TransportError:
        return False


def _all_threads_stopped(pid: int) -> bool:
    stats = filter(None, map(process_file, Path(f"/proc/{pid}/task").glob("*/stat")))  # a thread may have ended
    return all(stat.rpartition(b")")[2].split()[0] == b"T" for stat in stats)


def _at_rest(url: str) -> bool:
    time.sleep(0.3)  # what is under way at the server ends
    with psycopg.connect(url) as connection:
        query = """SELECT count(*) FROM pg_locks JOIN pg_stat_activity USING (pid)
            WHERE datname = current_database() AND mode = 'RowExclusiveLock'"""
        return connection.execute(query).fetchone() == (0,)


def _writable(database: Path) -> bool:
    with closing(sqlite3.connect(database, timeout=0.5, isolation_level=None)) as connection:
        try:
            connection.execute("BEGIN IMMEDIATE")
        except sqlite3.OperationalError:
            return False
        connection.execute("ROLLBACK")
        return True
