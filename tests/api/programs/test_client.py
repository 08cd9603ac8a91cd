"""The typed client and a real server: uploads, keys, TLS, and where gRPC is."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import pytest
from pydantic import ValidationError

from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import Settings
from fastsplat_client import Client, DeadlineExceededError, Retry, Subscription
from fastsplat_contract.errors import CancelledError, PermissionDeniedError, UnauthenticatedError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.jobs.operations import SceneOptions
from fastsplat_contract.messages.queries import QueryOut, QueryRequest
from tests.api.clients import client_of
from tests.api.line import Line
from tests.api.made_scene import add_scene, turned
from tests.api.served import Faces, OwnQuestions, served, serving
from tests.api.uploaded import photo, zipped
from tests.waiting import with_growing_limit

_SIZE = (320, 240)


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The same three photos as a folder and as an archive."""
    folder = tmp_path_factory.mktemp("capture")
    (folder / "photos").mkdir()
    (folder / "photos ü.zip").write_bytes(zipped(3, _SIZE))
    for number in range(3):
        (folder / "photos" / f"{number}.jpg").write_bytes(photo(number, _SIZE))
    return {"folder": folder / "photos", "archive": folder / "photos ü.zip"}


_OPTIONS = SceneOptions(
    ("mug", "story book"), time_budget_s=9.0, max_gaussians=500, preset="draft", priority=3, privacy="people"
)


@pytest.mark.parametrize("kind", ["folder", "archive"])
def test_a_capture_arrives_whole_with_its_options(
    faces: Faces, service: SceneService, captures: dict[str, Path], kind: str
) -> None:
    with client_of(faces, piece_bytes=100_000) as client:
        operation = client.create_scene(captures[kind], name="desk", options=_OPTIONS, request_id=f"desk-{kind}")
        again = client.create_scene(captures[kind], name="desk", options=_OPTIONS, request_id=f"desk-{kind}")
        assert again.id == operation.id
        record = service._store.scenes.operation(operation.id)
        stored = service._store.blobs.upload(record.upload_id) / record.options["validated"]
        photos = sorted(path for path in stored.rglob("*.jpg"))
        assert [path.read_bytes() for path in photos] == [photo(number, _SIZE) for number in range(3)]
        assert record.priority == 3 and record.options["preset"] == "draft" and record.options["privacy"] == "people"
        assert record.options["labels"] == ["mug", "story book"] and record.options["max_gaussians"] == 500
        client.delete_scene(operation.scene_id)


def test_an_upload_over_a_line_that_breaks_again_and_again_arrives_whole(
    faces: Faces, service: SceneService, captures: dict[str, Path]
) -> None:
    size = captures["archive"].stat().st_size
    line = Line(faces.ports.http, most_bytes=size // 3)
    retry = Retry(tries=20, first_s=0.01, most_s=0.05)
    with Client(f"http://127.0.0.1:{line.port}", retry=retry, piece_bytes=size // 5) as client:
        operation = client.create_scene(captures["archive"])
    line.take_down()
    assert line.connections > 2
    record = service._store.scenes.operation(operation.id)
    stored = service._store.blobs.upload(record.upload_id) / record.options["validated"]
    assert sorted(path.read_bytes() for path in stored.rglob("*.jpg")) == sorted(photo(n, _SIZE) for n in range(3))
    service.delete_scene(operation.scene_id)


def test_keys_and_tls_reach_both_ports(
    api_settings: Settings, tmp_path: Path, pem: Path, service: SceneService, scene_id: str
) -> None:
    settings = api_settings.model_copy(
        update={"auth": "on", "tls_cert": pem / "server.pem", "tls_key": pem / "server.key"}
    )
    read, write = (service.admin.keys.create(role, role)[1] for role in ("reader", "admin"))
    with serving(service, settings) as ports:
        url, target = f"https://127.0.0.1:{ports.http}", f"127.0.0.1:{ports.grpc}"
        with Client(url, key=read, ca=pem / "ca.pem") as client:  # which asks the server where gRPC is
            assert client.query(scene_id, "mug")[0].outcome == "here"
            question = Subscription(QueryRequest(scene_id, ("mug",), outputs=frozenset({"mask2d"})))
            (found,) = client.stream_query(question, [turned(0.0)])
            assert found.answers[0].masks[0].area > 0
            with pytest.raises(PermissionDeniedError):
                client.delete_scene(scene_id)
        with Client(url, key="wrong", grpc_target=target, ca=pem / "ca.pem") as client:
            with pytest.raises(UnauthenticatedError):
                client.scene(scene_id)
            with pytest.raises(UnauthenticatedError):
                list(client.stream_query(question, [turned(0.0)]))
        doomed = add_scene(service, api_settings, "doomed")
        with Client(url, key=write, ca=pem / "ca.pem") as client:
            client.delete_scene(doomed)


def test_clients_are_told_where_grpc_is(faces: Faces, service: SceneService, api_settings: Settings) -> None:
    with Client(str(faces.rest.base_url)) as client:
        assert client.server().grpc == f":{faces.ports.grpc}"
    mapped = api_settings.model_copy(update={"grpc_address": "robots.example:443"})
    with serving(service, mapped) as ports, Client(f"http://127.0.0.1:{ports.http}") as client:
        assert client.server().grpc == "robots.example:443"


@pytest.mark.parametrize("address", ["robots.example", "8001", "a b:1", "host:", "http://host:1"])
def test_an_address_without_a_port_is_none(address: str) -> None:
    with pytest.raises(ValidationError):
        Settings(grpc_address=address)


def _give_up(ask: Callable[[float], object], begun: threading.Event) -> None:
    """Ask with deadlines that pass; the last of them is long enough for the server to begin."""

    def attempt(limit_s: float) -> bool | None:
        with pytest.raises(DeadlineExceededError):
            ask(limit_s)
        return begun.is_set() or None

    assert with_growing_limit(attempt, 0.1)


class _Watched(OwnQuestions):
    """A service that tells when a question began, and how its last one ended."""

    error: BaseException | None = None

    def query(self, request: QueryRequest) -> QueryOut:
        self.begun.set()
        try:
            return self._service.answers.query(request)
        except BaseException as error:
            self.error = error
            raise
        finally:
            self.stopped.set()


@pytest.mark.parametrize("protocol", ["REST", "gRPC"])
def test_a_deadline_ends_the_rendering_of_many_views(
    service: SceneService, api_settings: Settings, scene_id: str, protocol: Literal["REST", "gRPC"]
) -> None:
    watched = _Watched(service)
    posed = turned(0.0)
    large = PosedCamera(posed.camera.scaled_to(4_000, 3_000), posed.world_from_camera)
    request = QueryRequest(scene_id, ("mug",), cameras=(large,) * 11, outputs=frozenset({"mask2d"}))
    with served(watched, api_settings) as faces, client_of(faces) as client:
        _give_up(lambda limit_s: client.ask(request, timeout_s=limit_s, protocol=protocol), watched.begun)
        assert watched.stopped.wait(60)
    assert isinstance(watched.error, CancelledError)
