"""Jobs on a Ray cluster of a head and two nodes, processes of this machine that are killed and stopped for real.

The nodes share the database and an object store, and nothing else: each has its own data folder, models and home.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import ExitStack, closing, suppress
from functools import partial
from pathlib import Path

import fsspec
import pytest

from fastsplat.service.application.service import open_service
from fastsplat.service.store.artefact_settings import ArtefactSettings
from fastsplat_contract.jobs.operations import Operation
from release.check_wheels import free_ports
from tests.postgres import PostgresServer
from tests.processes import is_alive, process_file
from tests.waiting import wait_for as _wait_for
from tests.workers.deployment import STAGES, Deployment, admit, children, kill, wait_over

wait_for = partial(_wait_for, patience_s=300.0)  # Ray takes its time
_RAY = [str(Path(sys.executable).with_name("ray")), "start", "--block", "--disable-usage-stats"]
_RAY += ["--no-monitor", "--include-log-monitor=false"]
_AS_ROOT = [] if os.geteuid() == 0 else ["--map-root-user"]
_HOST = ["unshare", "--uts", *_AS_ROOT, "sh", "-c", 'hostname "$0" && exec "$@"']  # machines are told apart by it
_PIDS = ["unshare", "--pid", "--fork", "--kill-child", "--mount-proc"]
"""A head that starts again looks among the processes of its machine for raylets, and would find those of the nodes."""
_MACHINES = {  # a job takes two CPUs; drivers look for the head by its address
    "head": ["--head", "--num-cpus=0", "--include-dashboard=false"],
    "small": ["--node-ip-address=127.0.0.2", "--num-cpus=2", f"--memory={64 << 30}"],
    "large": ["--node-ip-address=127.0.0.3", "--num-cpus=4", f"--memory={64 << 30}", "--num-gpus=1"],
}
_PROJECTS = ("default", "a", "b")
_PATIENT = {
    "RAY_NUM_REDIS_GET_RETRIES": "300",  # seconds, of a node that waits for its head
    "RAY_raylet_start_wait_time_s": "300",
    "RAY_worker_register_timeout_seconds": "300",
    "RAY_worker_niceness": "0",
    "RAY_raylet_liveness_self_check_interval_ms": "1000",  # until a node ends whose head is another
}
_TOKEN = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": uuid.uuid4().hex * 2}


class Cluster:
    """A head with the API's service and the launcher, and two nodes."""

    def __init__(self, folder: Path, url: str, artefacts: ArtefactSettings, opened: ExitStack) -> None:
        self.head, *self.nodes = (
            opened.enter_context(closing(Deployment(folder / name, url, artefacts=artefacts))) for name in _MACHINES
        )
        settings = self.head.settings
        cuda = settings.model_copy(update={"training": settings.training.model_copy(update={"backend": "cuda"})})
        self.for_gpus = opened.enter_context(closing(open_service(cuda, admit)))
        self._sockets = tempfile.mkdtemp(prefix="ray")  # short, as paths of sockets are
        opened.callback(shutil.rmtree, self._sockets, ignore_errors=True)
        self.ray: dict[Deployment, subprocess.Popen[bytes]] = {}
        opened.callback(self.lose, self.head, *self.nodes)
        (self._port,) = free_ports(1)
        for machine in (self.head, *self.nodes):
            self.start(machine)
        self._log = folder / "launcher.txt"
        self.start_launcher()

    def start(self, machine: Deployment) -> None:
        """Start Ray, after what is left of it; a head knows nothing of before."""
        if machine in self.ray and self.ray[machine].poll() is None:
            self.lose(machine)
        home = machine.settings.data_dir.with_name("home")
        home.mkdir(exist_ok=True)
        name, is_head = home.parent.name, machine is self.head
        place = f"--port={self._port}" if is_head else f"--address=127.0.0.1:{self._port}"
        common = [f"--object-store-memory={80 << 20}", f"--temp-dir={self._sockets}/{name}"]
        backend = {"FASTSPLAT_TRAINING__BACKEND": "cuda"} if "--num-gpus=1" in _MACHINES[name] else {}
        command = [*_HOST, name, *(_PIDS if is_head else []), *_RAY, *common, place, *_MACHINES[name]]
        self.ray[machine] = machine.start_command(command, HOME=str(home), **backend, **_PATIENT, **_TOKEN)

    def start_launcher(self) -> None:
        address = f"127.0.0.1:{self._port}"
        code = f"import os\nos.dup2(os.open({str(self._log)!r}, os.O_WRONLY | os.O_APPEND | os.O_CREAT), 2)\n"
        self.launcher = self.head.start_worker(code=code, FASTSPLAT_JOBS__LAUNCHER="ray", RAY_ADDRESS=address, **_TOKEN)

    def logs(self, machine: Deployment) -> str:
        """What the launcher has logged, or a node's agents."""
        folder = Path(self._sockets) / machine.settings.data_dir.parent.name
        paths = [self._log] if machine is self.head else folder.glob("session_2*/logs/worker-*.err")
        return "".join(path.read_text() for path in paths)

    def processes(self, machine: Deployment) -> list[int]:
        """Ids of Ray's processes on a machine and of all that they have started; children follow their parents."""
        found = [self.ray[machine].pid]
        for pid in found:
            found += children(pid)
        return found

    def named(self, name: str, *machines: Deployment) -> list[int]:
        """Ids of the processes on machines whose names begin so."""
        found = (pid for machine in machines for pid in self.processes(machine))
        return [pid for pid in found if process_file(Path(f"/proc/{pid}/comm")).startswith(name.encode())]

    def lose(self, *machines: Deployment) -> None:
        """kill -9 of all processes of machines, those of Ray, the launcher and jobs among them."""
        for machine in machines:
            for pid in self.processes(machine):
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            self.ray[machine].wait()
        if self.head in machines:
            kill(self.launcher)

    def visits(self, operation: Operation) -> dict[str, list[int]]:
        """Attempts that entered each stage of a job, anywhere."""
        every = {stage: [v for node in self.nodes for v in node.visits(stage, operation)] for stage in STAGES}
        return {stage: sorted(visit.attempt for visit in visits) for stage, visits in every.items()}

    def where(self, stage: str, operation: Operation) -> tuple[Deployment, int]:
        """The node on which a job entered a stage last, once it did, and the trainer's process id."""

        def found() -> list[tuple[int, Deployment, int]]:
            return [(v.attempt, n, v.pid) for n in self.nodes for v in n.visits(stage, operation)]

        wait_for(found)
        return max(found(), key=lambda visit: visit[0])[1:]

    def wait_stored(self, operation: Operation, stages: int) -> None:
        """Wait until the results of a job's first stages are with the object store, and the rows say so."""
        rows = self.head.service._store.scenes.operation
        wait_for(lambda: sum(bool(row.get("stored")) for row in rows(operation.id).stages) >= stages)

    def tell(self, word: str) -> None:
        """Let go on what waits for a word."""
        for node in self.nodes:
            (node.settings.data_dir / f"{word}.txt").touch()


@pytest.fixture(scope="module")
def _started(postgres: PostgresServer, s3: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    bucket = f"b{uuid.uuid4().hex}"
    fsspec.filesystem("s3", endpoint_url=s3, skip_instance_cache=True).mkdir(bucket)
    with postgres.database() as url, ExitStack() as opened:
        artefacts = ArtefactSettings(url=f"s3://{bucket}/place", endpoint_url=s3)
        yield Cluster(tmp_path_factory.mktemp("cluster"), url, artefacts, opened)


@pytest.fixture
def cluster(_started: Cluster) -> Iterator[Cluster]:
    """The same for all tests, which start again what they have lost; each job ends, and is published once or not."""
    yield _started
    store = _started.head.service._store
    wait_for(lambda: store.blobs.ids("jobs") == () and not store.jobs.in_turn(99) and not store.jobs.owners())
    wait_for(lambda: not _started.named("ray::_Agent", *_started.nodes))
    assert '"ERROR"' not in _started.logs(_started.head)
    every = [scene for name in _PROJECTS for scene in store.in_project(name).scenes.list_scenes(1000)]
    ready = sorted(scene.id for scene in every if scene.state == "READY")
    wait_for(lambda: sorted(scene for scene, _ in store.blobs.versions()) == ready)
    assert _started.launcher.poll() is None


def _attempts(**by_stage: list[int]) -> dict[str, list[int]]:
    """Visits of a job whose other stages the first attempt alone entered, once."""
    return {stage: [1] for stage in STAGES} | by_stage


def test_twelve_jobs_run_once_where_there_is_room_while_launchers_die(cluster: Cluster) -> None:
    service = cluster.head.service
    projects = [service.in_project(name) for name in _PROJECTS]
    first = [cluster.head.post("training:until_told", service=project) for project in projects]
    for job in first:
        cluster.where("training", job)
    drafted = cluster.head.post("training:draft", "export:until_asked")
    second = [drafted, *(cluster.head.post(service=project) for project in projects[1:])]
    last = [cluster.head.post(service=project) for project in projects[1:]]
    of_gpus = [cluster.head.post("export:until_asked", service=cluster.for_gpus)]
    waiting = {job.id for job in service._store.jobs.in_turn(99)}
    assert waiting == {job.id for job in (*second, *last, *of_gpus)}  # none is claimed without room

    assert cluster.named("ray::_Agent", *cluster.nodes)
    drivers = children(cluster.launcher.pid)
    kill(cluster.launcher)
    wait_for(lambda: not any(map(is_alive, drivers)))
    cluster.tell("told")
    for project, job in zip(projects, first, strict=True):
        assert wait_over(project, job).state == "SUCCEEDED"
    cluster.start_launcher()
    for job in (drafted, *of_gpus):
        cluster.where("export", job)
    of_gpus.append(cluster.head.post(service=cluster.for_gpus))
    failing = cluster.head.post("perception:defect")
    assert wait_over(service, failing).state == "FAILED"
    kill(cluster.launcher)
    cluster.start_launcher()  # while jobs run, and an actor waits for the GPU
    last.insert(0, cluster.head.post())
    assert wait_over(service, last[0]).state == "SUCCEEDED"
    assert of_gpus[1].id in {job.id for job in service._store.jobs.in_turn(99)}
    cluster.tell("asked")

    for project, *jobs in zip(projects, first, second, last, strict=True):
        for job in jobs:
            assert wait_over(project, job).state == "SUCCEEDED" and cluster.visits(job) == _attempts()
            assert project.get_scene(job.scene_id).state == "READY"
    for job in of_gpus:
        assert wait_over(service, job).state == "SUCCEEDED" and cluster.visits(job) == _attempts()
        assert not cluster.nodes[0].visits("capture", job)
    assert "ZeroDivisionError" in service.jobs.log(failing.id).log
    assert all(node.visits("capture") for node in cluster.nodes)
    ids = [job.id for job in (*first, *second, *last, failing, *of_gpus)]
    attempts = service._store.jobs.attempts_of(ids).values()
    assert [[bool(attempt.ended_at) for attempt in of_one] for of_one in attempts] == [[True]] * 12
    wait_for(lambda: not any(path.is_dir() for node in cluster.nodes for path in node.settings.data_dir.glob("jobs/*")))


def test_a_job_is_watched_and_ended_early_and_others_are_cancelled_in_any_stage(cluster: Cluster) -> None:
    service = cluster.head.service
    watched = cluster.head.post("training:until_finish")
    cancelled = [cluster.head.post(f"{stage}:sleep 600") for stage in ("capture", "training")]
    trainers = [cluster.where(stage, job)[1] for stage, job in zip(("capture", "training"), cancelled, strict=True)]
    cancelled.append(cluster.head.post())  # for which there is no room
    wait_for(lambda: (preview := service.get_operation(watched.id).preview) is not None and preview.number >= 3)
    assert service.jobs.preview(watched.id).picture.startswith(b"attempt 1 picture ")
    for job in reversed(cancelled):
        service.cancel_operation(job.id)
        assert wait_over(cluster.head.service, job).state == "CANCELLED"
    wait_for(lambda: not any(map(is_alive, trainers)))
    service.jobs.finish(watched.id)
    assert wait_over(service, watched).state == "SUCCEEDED"
    assert service.get_scene(watched.scene_id).quality["stopped_early"]


@pytest.mark.parametrize("end", ["of all", "of Ray alone", "stopped"])
def test_a_job_of_a_lost_node_goes_on_elsewhere_from_the_last_stage_and_is_fenced_on_the_first(
    cluster: Cluster, end: str
) -> None:
    job = cluster.head.post("training:until_finish")
    node, trainer = cluster.where("training", job)
    cluster.wait_stored(job, 2)
    stopped = cluster.processes(node) if end == "stopped" else []
    for pid in stopped:
        os.kill(pid, signal.SIGSTOP)
    if end == "of Ray alone":  # whose processes end by themselves, somewhat later
        os.kill(*cluster.named("raylet", node), signal.SIGKILL)
    elif end == "of all":
        cluster.lose(node)
    wait_for(lambda: cluster.visits(job)["training"] == [1, 2] and cluster.head.service.get_operation(job.id).preview)
    assert not stopped or is_alive(trainer)
    for pid in stopped:  # those that wake first may end the last
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)
    wait_for(lambda: not is_alive(trainer))
    cluster.head.service.jobs.finish(job.id)
    assert wait_over(cluster.head.service, job).state == "SUCCEEDED"
    assert cluster.visits(job) == _attempts(training=[1, 2], export=[2])
    cluster.start(node)


def test_the_head_alone_is_lost_and_jobs_go_on_from_the_last_stage_once_there_is_one_again(cluster: Cluster) -> None:
    jobs = [cluster.head.post("training:sleep_once 600") for _ in range(2)]
    trainers = [cluster.where("training", job)[1] for job in jobs]
    for job in jobs:
        cluster.wait_stored(job, 2)
    os.kill(*cluster.named("gcs_server", cluster.head), signal.SIGKILL)
    cluster.ray[cluster.head].wait()
    waiting = cluster.head.post()
    cluster.start(cluster.head)
    wait_for(lambda: "the Ray cluster is away" in cluster.logs(cluster.head))
    for node in cluster.nodes:  # which have never heard of this head
        cluster.ray[node].wait()
        cluster.start(node)
    wait_for(lambda: not any(map(is_alive, trainers)))
    for job in jobs:
        assert wait_over(cluster.head.service, job).state == "SUCCEEDED"
        assert cluster.visits(job) == _attempts(training=[1, 2], export=[2])
        saved_s = sum(row["seconds"] for row in cluster.head.service._store.scenes.operation(job.id).stages[:2])
        line = re.compile(rf"{job.id} attempt 2 pid \d+, {saved_s:.1f} s of work saved")
        assert line.search(cluster.logs(cluster.where("export", job)[0]))
    assert wait_over(cluster.head.service, waiting).state == "SUCCEEDED" and cluster.visits(waiting) == _attempts()


def test_a_driver_ends_where_no_head_answers() -> None:
    code = "from fastsplat.workers.engine import ray_cluster as it; it._PATIENCE_S = 1; it._place({}, {})"
    environment = {**os.environ, "RAY_ADDRESS": f"127.0.0.1:{free_ports(1)[0]}"}
    assert subprocess.run([sys.executable, "-c", code], env=environment, check=False).returncode == -signal.SIGALRM
