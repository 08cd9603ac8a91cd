"""One process, two ports: health, reflection, the page, and a stop that lets work finish."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import httpx
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha import reflection_pb2, reflection_pb2_grpc

from api.server import _listen, serve
from service.calls.service import SceneService
from service.common.errors import ResourceError
from service.settings import Settings
from tests.api.served import Faces, served


def test_health_answers_on_both_ports(faces: Faces) -> None:
    assert faces.rest.get("/livez").json() == {"status": "ok"}
    assert faces.rest.get("/readyz").status_code == 200
    stub = health_pb2_grpc.HealthStub(faces.channel)
    for name in ("", "fastsplat.v1.SceneService"):
        answer = stub.Check(health_pb2.HealthCheckRequest(service=name))
        assert answer.status == health_pb2.HealthCheckResponse.SERVING


def test_not_ready_without_a_database(api_settings: Settings) -> None:
    class Broken:
        def list_scenes(self, page_size: int, page_token: str) -> None:
            raise ResourceError("the database is gone")

    with served(Broken(), api_settings) as faces:
        assert faces.rest.get("/livez").status_code == 200
        refused = faces.rest.get("/readyz")
        assert refused.status_code == 503 and refused.headers["retry-after"]


def test_reflection_lists_the_service(faces: Faces) -> None:
    stub = reflection_pb2_grpc.ServerReflectionStub(faces.channel)
    (answer,) = stub.ServerReflectionInfo(iter([reflection_pb2.ServerReflectionRequest(list_services="")]))
    names = {service.name for service in answer.list_services_response.service}
    assert {"fastsplat.v1.SceneService", "grpc.health.v1.Health"} <= names


def test_the_page_and_its_files_come_from_here_alone(faces: Faces) -> None:
    page = faces.rest.get("/")
    assert page.status_code == 200 and page.headers["content-type"].startswith("text/html")
    assert "default-src 'self'" in page.headers["content-security-policy"]
    links = re.findall(r'(?:src|href)="([^"]+)"', page.text)
    assert links
    for link in links:
        assert link.startswith("/") and faces.rest.get(link).status_code == 200


def test_the_api_description_needs_no_other_host(faces: Faces) -> None:
    page = faces.rest.get("/docs")
    links = re.findall(r"""(?:src|href)=["']([^"']+)["']""", page.text)
    assert len(links) >= 2
    for link in (*links, "/openapi.json"):
        assert link.startswith("/") and faces.rest.get(link).status_code == 200


def test_a_taken_port_is_an_error_that_names_the_setting(service: SceneService, faces: Faces) -> None:
    for field, port in (("http_port", faces.ports.http), ("grpc_port", faces.ports.grpc)):
        settings = Settings(**{"http_port": 0, "grpc_port": 0, field: port})
        with pytest.raises(ResourceError) as caught:
            asyncio.run(serve(service, settings, asyncio.Event()))
        assert caught.value.field == field


def test_answers_do_not_wait_for_acknowledgements() -> None:
    with _listen("127.0.0.1", 0) as listener, socket.create_connection(listener.getsockname()):
        accepted, _ = listener.accept()
        with accepted:
            assert accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_slow_calls_hold_up_nobody(api_settings: Settings) -> None:
    release = threading.Event()

    class Slow:
        def get_scene(self, scene_id: str) -> None:
            release.wait(30)
            raise ResourceError("late")

    with served(Slow(), api_settings) as faces, httpx.Client(base_url=faces.rest.base_url, timeout=60) as other:
        caller = threading.Thread(target=lambda: other.get("/v1/scenes/x"))
        caller.start()
        assert faces.rest.get("/livez").status_code == 200
        assert caller.is_alive()
        release.set()
        caller.join()


_SERVE = """
import logging, sys, time
from pathlib import Path
from api.server import run
from service.calls.service import SceneService
from service.settings import Settings
logging.basicConfig(level=logging.INFO)
def slow(self, scene_id):
    print("BEGUN", flush=True)
    time.sleep(1.0)
    return real(self, scene_id)
real, SceneService.get_scene = SceneService.get_scene, slow
run(Settings(data_dir=Path(sys.argv[1]), http_port=0, grpc_port=0))
print("STOPPED", flush=True)
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_lets_running_calls_finish(tmp_path: Path, number: signal.Signals) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", _SERVE, str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[2],
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    assert process.stderr is not None and process.stdout is not None
    try:
        match = None
        while match is None:
            line = process.stderr.readline()
            assert line, "the server did not start"
            match = re.search(r"HTTP on http://127\.0\.0\.1:(\d+), gRPC on 127\.0\.0\.1:(\d+)", line)
        port = int(match[1])
        answers: list[int] = []
        asking = threading.Thread(
            target=lambda: answers.append(httpx.get(f"http://127.0.0.1:{port}/v1/scenes/none", timeout=30).status_code)
        )
        asking.start()
        assert process.stdout.readline() == "BEGUN\n"
        process.send_signal(number)
        asking.join(30)
        assert answers == [404]
        assert process.stdout.readline() == "STOPPED\n"
        assert process.wait(30) == 0
        with pytest.raises(httpx.ConnectError):
            httpx.get(f"http://127.0.0.1:{port}/livez")
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
        process.stderr.close()
