"""`fastsplat serve`: all run, all stop; what dies comes back, unless it is hopeless."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from release.check_wheels import free_ports
from tests.processes import is_alive
from tests.waiting import wait_for

ROOT = Path(__file__).parent.parent.parent
_SERVE = """
import sys
from fastsplat.cli.operating.logs import log_to_stderr
import fastsplat.cli.operating.serve
from fastsplat.cli.operating.serve import Role, serve
log_to_stderr("serve")
fastsplat.cli.operating.serve._SUSPENDED_S, fastsplat.cli.operating.serve._AFTER_CRASH_S = 0.5, 0.1
fastsplat.cli.operating.serve._MAX_PAUSE_S = 0.2
sys.exit(serve({name: Role([sys.executable, name, sys.argv[1]], {"ROLE": name}) for name in sys.argv[2:]}))
"""
_STEADY = """
import os, pathlib, signal, sys, time
from fastsplat.service.common.process import PARENT_VARIABLE, die_with_parent
here = pathlib.Path(sys.argv[1]) / pathlib.Path(__file__).stem
def leave(*_):
    here.with_suffix(".stopped").touch()
    sys.exit(0)
signal.signal(signal.SIGTERM, leave)
die_with_parent(int(os.environ[PARENT_VARIABLE]))
with here.with_suffix(".pids").open("a") as file:
    file.write(f"{os.getpid()}\\n")
time.sleep(600)
"""


class Serving:
    """One supervisor over scripts in a folder."""

    def __init__(self, folder: Path, **scripts: str) -> None:
        self.folder = folder
        for name, text in scripts.items():
            (folder / f"{name}.py").write_text(text)
        paths = [str(folder / f"{name}.py") for name in scripts]
        self.process = subprocess.Popen(
            [sys.executable, "-c", _SERVE, str(folder), *paths], env={**os.environ, "PYTHONPATH": str(ROOT)}
        )

    def pids(self, name: str) -> list[int]:
        path = self.folder / f"{name}.pids"
        return [int(line) for line in path.read_text().split()] if path.exists() else []


@pytest.fixture
def serving(tmp_path: Path) -> Iterator[Callable[..., Serving]]:
    servers: list[Serving] = []

    def make(**scripts: str) -> Serving:
        servers.append(Serving(tmp_path, **scripts))
        return servers[-1]

    yield make
    for server in servers:
        server.process.kill()
        server.process.wait()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_stops_all_in_good_order(serving, number):
    served = serving(one=_STEADY, two=_STEADY)
    wait_for(lambda: served.pids("one") and served.pids("two"))
    served.process.send_signal(number)
    assert served.process.wait(timeout=30) == 0
    assert (served.folder / "one.stopped").exists() and (served.folder / "two.stopped").exists()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_what_dies_or_is_stopped_for_long_is_started_again(serving, number):
    served = serving(one=_STEADY, two=_STEADY)
    wait_for(lambda: served.pids("one") and served.pids("two"))
    os.kill(served.pids("one")[0], number)
    wait_for(lambda: len(served.pids("one")) == 2)
    assert not is_alive(served.pids("one")[0])
    assert len(served.pids("two")) == 1 and served.process.poll() is None


def test_what_dies_again_and_again_ends_all(serving):
    served = serving(one=_STEADY, bad="raise SystemExit(3)")
    assert served.process.wait(timeout=60) == 1
    assert not any(is_alive(pid) for pid in served.pids("one"))


def test_crashes_however_many_end_nothing(serving):
    crashing = _STEADY.replace("time.sleep(600)", "os.kill(os.getpid(), signal.SIGKILL)")
    served = serving(one=_STEADY, crashing=crashing)
    wait_for(lambda: len(served.pids("crashing")) > 6)
    assert served.process.poll() is None and len(served.pids("one")) == 1


def test_children_do_not_outlive_a_killed_supervisor(serving):
    served = serving(one=_STEADY)
    wait_for(lambda: served.pids("one"))
    served.process.kill()
    wait_for(lambda: not is_alive(served.pids("one")[0]))


def test_ports_in_use_are_named_at_once_and_nothing_is_written(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as http, socket.create_server(("127.0.0.1", 0)) as metrics:
        ports = [server.getsockname()[1] for server in (http, metrics)]
        environment = {
            **os.environ,
            "FASTSPLAT_HTTP_PORT": str(ports[0]),
            "FASTSPLAT_GRPC_PORT": "0",
            "FASTSPLAT_METRICS_PORT": str(ports[1]),
        }
        command = [sys.executable, "-m", "fastsplat.cli.main", "serve"]
        ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=100)
    assert (ended.returncode, ended.stdout, list(tmp_path.iterdir())) == (2, "", [])
    assert f"ports {ports[0]}, {ports[1]}" in ended.stderr
    assert "FASTSPLAT_HTTP_PORT, FASTSPLAT_METRICS_PORT" in ended.stderr


_DEMONSTRATION = """
import sys, time
from pathlib import Path
from fastsplat.cli.demo.service_process import running_service
here, models, http, grpc = Path(sys.argv[1]), Path(sys.argv[2]), *map(int, sys.argv[3:])
with running_service(data_dir=here / "data", models=models, log=here / "log", http_port=http, grpc_port=grpc):
    print("ready", flush=True)
    time.sleep(600)
"""


def test_the_service_of_a_demonstration_that_is_killed_ends_with_it(tmp_path: Path, lexicon_models_dir: Path) -> None:
    http, grpc = free_ports(2)
    command = [sys.executable, "-c", _DEMONSTRATION, str(tmp_path), str(lexicon_models_dir), str(http), str(grpc)]
    with subprocess.Popen(command, env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None and process.stdout.readline() == b"ready\n"
            children = _descendants(process.pid)
            assert len(children) >= 3  # serve, the API and a worker
        finally:
            process.kill()
    wait_for(lambda: not any(is_alive(pid) for pid in children))


def _descendants(pid: int) -> list[int]:
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [descendant for child in map(int, children) for descendant in (child, *_descendants(child))]
