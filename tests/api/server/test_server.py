"""One process, two ports: health, reflection, the page, and a stop that lets work finish."""

from __future__ import annotations

import asyncio
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from urllib.parse import urlsplit

import grpc
import httpx
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha import reflection_pb2, reflection_pb2_grpc

from fastsplat.api.server import _listen, serve
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import Settings
from fastsplat_client.stream import SceneServiceStub
from fastsplat_contract.errors import ResourceError
from fastsplat_contract.v1 import fastsplat_pb2
from tests.api.made_scene import ENCODER, write_words
from tests.api.served import Faces, served
from tests.api.uploaded import photos, post
from tests.color_segmenter import write_color_segmenter
from tests.waiting import wait_for


def test_health_answers_on_both_ports(faces: Faces) -> None:
    assert faces.rest.get("/livez").json() == {"status": "ok"}
    assert faces.rest.get("/readyz").status_code == 200
    stub = health_pb2_grpc.HealthStub(faces.channel)
    for name in ("", "fastsplat.v1.SceneService"):
        answer = stub.Check(health_pb2.HealthCheckRequest(service=name))
        assert answer.status == health_pb2.HealthCheckResponse.SERVING


def test_not_ready_without_models_until_they_come(
    api_settings: Settings, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    settings = api_settings.model_copy(update={"data_dir": tmp_path / "data", "models": tmp_path / "models"})
    with open_service(settings) as service, served(service, settings) as faces:
        (warning,) = [line for line in caplog.messages if "fastsplat models pull" in line]
        assert f"{settings.models} (FASTSPLAT_MODELS) lacks {ENCODER} (perception.text_encoder)" in warning
        stub = health_pb2_grpc.HealthStub(faces.channel)

        def status() -> tuple[int, int]:
            return faces.rest.get("/readyz").status_code, stub.Check(health_pb2.HealthCheckRequest()).status

        assert status() == (503, health_pb2.HealthCheckResponse.NOT_SERVING)
        refused = faces.rest.get("/readyz")
        assert refused.headers["retry-after"] and "words" in refused.json()["detail"]
        assert faces.rest.get("/livez").status_code == 200
        write_words(settings.models)
        wait_for(lambda: status() == (200, health_pb2.HealthCheckResponse.SERVING))


def test_photos_whose_job_would_lack_a_model_are_refused_when_they_are_posted(
    api_settings: Settings, tmp_path: Path
) -> None:
    settings = api_settings.model_copy(update={"data_dir": tmp_path / "data", "models": tmp_path / "models"})
    write_words(settings.models)
    write_color_segmenter(settings.models)
    shutil.rmtree(settings.models / "grounding_dino_tiny")
    with open_service(settings) as service, served(service, settings) as faces:
        refused = post(faces, photos(3))
        assert (refused.status_code, refused.json()["reason"]) == (409, "MODEL_UNAVAILABLE")
        assert "grounding_dino_tiny (perception.open_set_detector)" in refused.json()["detail"]
        assert refused.json()["field"] == "models" and "FASTSPLAT_MODELS" in refused.json()["hint"]
        states = {model["role"]: model["state"] for model in faces.rest.get("/v1/server/status").json()["models"]}
        assert states["open_set_detector"] == "missing" and states["closed_set_detector"] == "ready"
        assert faces.rest.get("/v1/scenes").json()["scenes"] == []
        (settings.models / "grounding_dino_tiny").mkdir()
        (settings.models / "grounding_dino_tiny" / "model.onnx").touch()
        assert post(faces, photos(3)).status_code == 202


def _gone_database(service: SceneService, settings: Settings) -> None:
    (settings.data_dir / "fastsplat.sqlite").rename(settings.data_dir / "elsewhere")
    (settings.data_dir / "fastsplat.sqlite").mkdir()
    service.admin.keys._rows._engine.dispose()  # open handles would still see the file


def _read_only_folder(service: SceneService, settings: Settings) -> None:
    # A folder of mode 0500 stops nobody who tests as root.
    shutil.rmtree(settings.data_dir)


@pytest.mark.parametrize("breakage", [_gone_database, _read_only_folder])
def test_what_breaks_later_ends_readiness_but_not_life(
    api_settings: Settings, tmp_path: Path, breakage: Callable[[SceneService, Settings], None]
) -> None:
    settings = api_settings.model_copy(update={"data_dir": tmp_path / "data"})
    with open_service(settings) as service, served(service, settings) as faces:
        assert faces.rest.get("/readyz").status_code == 200
        breakage(service, settings)
        stub = health_pb2_grpc.HealthStub(faces.channel)
        wait_for(lambda: faces.rest.get("/readyz").status_code == 503)
        wait_for(
            lambda: stub.Check(health_pb2.HealthCheckRequest()).status == health_pb2.HealthCheckResponse.NOT_SERVING
        )
        assert faces.rest.get("/livez").status_code == 200


def test_reflection_lists_the_service(faces: Faces) -> None:
    stub = reflection_pb2_grpc.ServerReflectionStub(faces.channel)
    (answer,) = stub.ServerReflectionInfo(iter([reflection_pb2.ServerReflectionRequest(list_services="")]))
    names = {service.name for service in answer.list_services_response.service}
    assert {"fastsplat.v1.SceneService", "grpc.health.v1.Health"} <= names


def test_the_page_and_its_files_come_from_here_alone(faces: Faces) -> None:
    page = faces.rest.get("/")
    assert page.status_code == 200 and page.headers["content-type"].startswith("text/html")
    policy = page.headers["content-security-policy"]
    assert "default-src 'none'" in policy and "connect-src 'self'" in policy and "unsafe" not in policy
    links = re.findall(r'(?:src|href)="([^"]+)"', page.text)
    assert links
    for link in links:
        assert _is_relative(link) and faces.rest.get(f"/{link}").status_code == 200


def test_the_api_description_needs_no_other_host(faces: Faces) -> None:
    page = faces.rest.get("/docs")
    links = re.findall(r"""(?:src|href)=["']([^"']+)["']""", page.text)
    assert len(links) >= 2
    for link in (*links, "openapi.json"):
        assert _is_relative(link) and faces.rest.get(f"/{link}").status_code == 200


def _is_relative(link: str) -> bool:
    """To the page itself, so that it also holds below a proxy's path."""
    parts = urlsplit(link)
    return not parts.scheme and not parts.netloc and not link.startswith("/")


def test_a_taken_port_is_an_error_that_names_the_setting(service: SceneService, faces: Faces) -> None:
    ports = {"http_port": faces.ports.http, "grpc_port": faces.ports.grpc, "metrics_port": faces.ports.metrics}
    for field, port in ports.items():
        settings = Settings(**{"http_port": 0, "grpc_port": 0, "metrics_port": 0, field: port})
        with pytest.raises(ResourceError) as caught:
            asyncio.run(serve(service, settings, asyncio.Event()))
        assert caught.value.field == field


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_a_loopback_is_both_and_answers_do_not_wait_for_acknowledgements(host: str) -> None:
    listeners = _listen(host, 0)
    assert {listener.getsockname()[0] for listener in listeners} == (
        {"127.0.0.1", "::1"} if socket.has_dualstack_ipv6() else {host}
    )
    for listener in listeners:
        with listener, socket.create_connection(listener.getsockname()[:2]):
            accepted, _ = listener.accept()
            with accepted:
                assert accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


_SERVE = """
import logging, sys
from pathlib import Path
from urllib.parse import urlsplit
from fastsplat.api.server import run
from fastsplat_client.stream import SceneServiceStub
from fastsplat_contract.v1 import fastsplat_pb2
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import Settings
logging.basicConfig(level=logging.INFO)
def slow(self, scene_id):
    print("BEGUN", flush=True)
    sys.stdin.read()  # until the test lets it go on
    return real(self, scene_id)
real, SceneService.get_scene = SceneService.get_scene, slow
ports = {"http_port": 0, "grpc_port": 0, "metrics_port": 0}
run(Settings(data_dir=Path(sys.argv[1]), **ports, auth="off", drain_notice_s=5.0, drain_s=120.0))
print("STOPPED", flush=True)
"""


def _refuses_connections(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), timeout=60).close()
    except ConnectionRefusedError:
        return True
    return False


def test_a_signal_lets_running_calls_finish(tmp_path: Path) -> None:
    """SIGTERM; for SIGINT, see test_stopping."""
    process = subprocess.Popen(
        [sys.executable, "-c", _SERVE, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[3],
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    assert process.stdin is not None and process.stderr is not None and process.stdout is not None
    try:
        match = None
        while match is None:
            line = process.stderr.readline()
            assert line, "the server did not start"
            match = re.search(r"HTTP on http://127\.0\.0\.1:(\d+), gRPC on 127\.0\.0\.1:(\d+)", line)
        port = int(match[1])
        answers: list[int] = []
        asking = threading.Thread(
            target=lambda: answers.append(httpx.get(f"http://127.0.0.1:{port}/v1/scenes/none", timeout=120).status_code)
        )
        asking.start()
        with grpc.insecure_channel(f"127.0.0.1:{match[2]}") as channel:
            over_grpc = SceneServiceStub(channel).GetScene.future(fastsplat_pb2.GetSceneRequest(scene_id="none"))
            for _ in range(2):
                assert process.stdout.readline() == "BEGUN\n"
            process.send_signal(signal.SIGTERM)
            wait_for(lambda: "about to stop" in httpx.get(f"http://127.0.0.1:{port}/readyz", timeout=60).text)
            assert httpx.get(f"http://127.0.0.1:{port}/livez", timeout=60).status_code == 200
            check = health_pb2_grpc.HealthStub(channel).Check(health_pb2.HealthCheckRequest())
            assert check.status == health_pb2.HealthCheckResponse.NOT_SERVING
            wait_for(lambda: _refuses_connections(port))  # and both calls still run
            process.stdin.close()
            asking.join(60)
            assert answers == [404]
            assert over_grpc.exception(30).code() == grpc.StatusCode.NOT_FOUND
        assert process.stdout.readline() == "STOPPED\n"
        assert process.wait(60) == 0
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
        process.stderr.close()
