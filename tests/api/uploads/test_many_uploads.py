"""Hundreds of slow uploads cost connections and no threads: an ordinary upload and a question pass beside them."""

from __future__ import annotations

import resource
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import LimitSettings, Settings
from tests.api.made_scene import add_scene
from tests.api.served import Faces, served
from tests.api.uploaded import TUS, announced, messages, photos, post
from tests.waiting import wait_for

_FORMS, _PIECES = 450, 50
_MOST_THREADS = 40
_FORM_HEAD = (
    "POST /v1/scenes HTTP/1.1\r\nHost: localhost\r\nContent-Type: multipart/form-data; boundary=x\r\n"
    "Content-Length: 1000000\r\n\r\n"
    '--x\r\nContent-Disposition: form-data; name="images"; filename="a.jpg"\r\n\r\nab'
)


@pytest.fixture
def files() -> Iterator[None]:
    """Enough open files for both ends of every connection."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, 8_192), hard))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.mark.usefixtures("files")
def test_slow_uploads_hold_no_threads(api_settings: Settings, tmp_path: Path) -> None:
    limits = LimitSettings(uploads=2_000, in_flight=2_000, all_uploads=2_000)
    settings = api_settings.model_copy(update={"data_dir": tmp_path / "data", "limits": limits})
    with open_service(settings) as service, served(service, settings) as faces, ExitStack() as connections:
        scene_id = add_scene(service, settings)
        address = ("127.0.0.1", faces.ports.http)
        begun = [faces.rest.post("/v1/uploads", headers=announced("a.jpg", 1_000)) for _ in range(_PIECES)]
        paths = [str(response.headers["location"]) for response in begun]
        before = threading.active_count()
        slow = [connections.enter_context(socket.create_connection(address)) for _ in range(_FORMS + _PIECES)]
        for connection in slow[:_FORMS]:
            connection.sendall(_FORM_HEAD.encode())
        for connection, path in zip(slow[_FORMS:], paths, strict=True):
            connection.sendall(
                f"PATCH {path} HTTP/1.1\r\nHost: localhost\r\nTus-Resumable: 1.0.0\r\nUpload-Offset: 0\r\n"
                "Content-Type: application/offset+octet-stream\r\nContent-Length: 1000\r\n\r\nab".encode()
            )
        root = settings.data_dir / "uploads"
        wait_for(lambda: len(list(root.glob("*/raw/a.jpg"))) == _FORMS)
        wait_for(lambda: sum(path.stat().st_size for path in root.glob("*/data")) == 2 * _PIECES)

        assert threading.active_count() - before < _MOST_THREADS
        answer = faces.rest.post(f"/v1/scenes/{scene_id}:query", json={"texts": ["mug"]})
        assert answer.status_code == 200, answer.text
        _posts_pass(faces, service)
        assert threading.active_count() - before < _MOST_THREADS

        for connection in slow:
            connection.sendall(b"cd")  # all of them are still being received
        wait_for(lambda: sum(path.stat().st_size for path in root.glob("*/data")) == 4 * _PIECES)
        for connection in slow:
            connection.close()
        wait_for(lambda: len(list(root.glob("*/raw/a.jpg"))) == 0)  # what was cut leaves nothing
        # and what came of a piece stays
        wait_for(lambda: {faces.rest.head(path, headers=TUS).headers["upload-offset"] for path in paths} == {"4"})


def _posts_pass(faces: Faces, service: SceneService) -> None:
    over_rest = post(faces, photos(2), {"name": "ordinary"})
    assert over_rest.status_code == 202, over_rest.text
    over_grpc = faces.rpc.CreateScene(messages(photos(2), name="ordinary"))
    for operation_id in (over_rest.json()["id"], over_grpc.id):
        assert service.get_operation(operation_id).state == "QUEUED"
