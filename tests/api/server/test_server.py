"""One process, two ports: health, reflection, the page, and a stop that lets work finish."""

from __future__ import annotations

import asyncio
import shutil
import signal
import socket
import threading
from collections.abc import Callable
from pathlib import Path

import grpc
import httpx
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc

from fastsplat.api.server import _listen, serve
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import Settings
from fastsplat_client.stream import SceneServiceStub
from fastsplat_contract.errors import ResourceError
from fastsplat_contract.v1 import fastsplat_pb2
from tests.api.made_scene import ENCODER, write_words
from tests.api.served import Faces, served
from tests.api.server_process import SERVE, server_process
from tests.api.uploaded import photos, post
from tests.color_segmenter import write_color_segmenter
from tests.waiting import wait_for


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
        assert faces.rest.get("/livez").json() == {"status": "ok"}
        write_words(settings.models)
        wait_for(lambda: status() == (200, health_pb2.HealthCheckResponse.SERVING))
        by_name = stub.Check(health_pb2.HealthCheckRequest(service="fastsplat.v1.SceneService"))
        assert by_name.status == health_pb2.HealthCheckResponse.SERVING


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
    service.admin.keys._rows._writing.args[0].dispose()  # open handles would still see the file


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


_SLOW = """
import sys
from fastsplat.api import server
from fastsplat.service.application.service import SceneService
# SciPy fails in questions that come while torch is imported.
listen, server._listen = server._listen, lambda *where: sys.modules["torch"].Tensor and listen(*where)
def slow(self, scene_id):
    print("BEGUN", flush=True)
    sys.stdin.read()  # until the test lets it go on
    return real(self, scene_id)
real, SceneService.get_scene = SceneService.get_scene, slow
"""


def _refuses_connections(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), timeout=60).close()
    except ConnectionRefusedError:
        return True
    return False


def test_a_signal_lets_running_calls_finish(tmp_path: Path) -> None:
    """SIGTERM; for SIGINT, see test_stopping."""
    free_ports = {"http_port": 0, "grpc_port": 0, "metrics_port": 0}
    settings = Settings(data_dir=tmp_path / "data", **free_ports, auth="off", drain_notice_s=5.0, drain_s=120.0)
    with server_process(settings, _SLOW + SERVE) as server, grpc.insecure_channel(server.grpc_target) as channel:
        answers: list[int] = []
        asking = threading.Thread(
            target=lambda: answers.append(httpx.get(f"{server.url}/v1/scenes/none", timeout=120).status_code)
        )
        asking.start()
        over_grpc = SceneServiceStub(channel).GetScene.future(fastsplat_pb2.GetSceneRequest(scene_id="none"))
        wait_for(lambda: server.log.read_text().count("BEGUN") == 2)
        server.process.send_signal(signal.SIGTERM)
        wait_for(lambda: "about to stop" in httpx.get(f"{server.url}/readyz", timeout=60).text)
        assert httpx.get(f"{server.url}/livez", timeout=60).status_code == 200
        check = health_pb2_grpc.HealthStub(channel).Check(health_pb2.HealthCheckRequest())
        assert check.status == health_pb2.HealthCheckResponse.NOT_SERVING
        wait_for(lambda: _refuses_connections(server.http_port))  # and both calls still run
        assert server.process.stdin is not None
        server.process.stdin.close()
        asking.join(60)
        assert answers == [404]
        assert over_grpc.exception(30).code() == grpc.StatusCode.NOT_FOUND
        assert server.process.wait(60) == 0
