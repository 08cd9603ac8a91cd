"""The tus protocol 1.0.0, header by header, and the scene that is made of what it brought."""

from __future__ import annotations

import base64
import hashlib
import itertools
import random
import socket
import time
from email.utils import parsedate_to_datetime

import httpx
import pytest

from fastsplat.service.application.service import SceneService
from tests.api.conftest import MAX_UPLOAD_BYTES
from tests.api.served import Faces, rest_refusal
from tests.api.uploaded import PIECE, TUS, zipped


def _name(name: str) -> dict[str, str]:
    return {"Upload-Metadata": f"filename {base64.b64encode(name.encode()).decode()},note aGk="}


def _create(faces: Faces, name: str, length: int, **headers: str) -> str:
    response = faces.rest.post("/v1/uploads", headers={**TUS, "Upload-Length": str(length), **_name(name), **headers})
    assert response.status_code == 201, response.text
    return str(response.headers["location"])


def _patch(faces: Faces, path: str, offset: int, data: bytes, **headers: str) -> httpx.Response:
    return faces.rest.patch(path, content=data, headers={**PIECE, "Upload-Offset": str(offset), **headers})


def test_the_server_says_what_it_speaks(faces: Faces) -> None:
    options = faces.rest.options("/v1/uploads")
    assert options.status_code == 204 and options.headers["tus-version"] == "1.0.0"
    extensions = set(options.headers["tus-extension"].split(","))
    assert extensions == {"creation", "creation-with-upload", "checksum", "expiration", "termination"}
    assert int(options.headers["tus-max-size"]) == MAX_UPLOAD_BYTES
    assert set(options.headers["tus-checksum-algorithm"].split(",")) == {"sha1", "sha256"}


def test_a_capture_comes_in_pieces_and_becomes_a_scene_once(faces: Faces, service: SceneService) -> None:
    data = zipped(3)
    path = _create(faces, "capture.zip", len(data))
    rng = random.Random(3)
    cuts = [0, *sorted(rng.sample(range(1, len(data)), 20)), len(data)]
    for begin, end in itertools.pairwise(cuts):
        answer = _patch(faces, path, begin, data[begin:end])
        assert answer.status_code == 204 and answer.headers["upload-offset"] == str(end)
        assert answer.headers["tus-resumable"] == "1.0.0"
        assert parsedate_to_datetime(answer.headers["upload-expires"]).year >= 2020
    head = faces.rest.head(path, headers=TUS)
    assert head.headers["upload-offset"] == head.headers["upload-length"] == str(len(data))
    assert head.headers["cache-control"] == "no-store" and head.headers["upload-metadata"].endswith("note aGk=")
    fields = {"uploads": path.rpartition("/")[2], "name": "in pieces", "request_id": f"tus-{time.time_ns()}"}
    form = {name: (None, value) for name, value in fields.items()}
    first, again = (faces.rest.post("/v1/scenes", files=form) for _ in range(2))
    assert first.status_code == again.status_code == 202, first.text
    assert first.json()["id"] == again.json()["id"]
    record = service._store.scenes.operation(first.json()["id"])
    folder = service._store.blobs.upload(record.upload_id)
    assert len(list(folder.rglob("*.jpg"))) == 3
    assert faces.rest.delete(path, headers=TUS).status_code == 204
    assert len(list(folder.rglob("*.jpg"))) == 3
    faces.rest.delete(f"/v1/scenes/{first.json()['scene_id']}")


def test_a_connection_that_breaks_leaves_what_was_taken(faces: Faces, service: SceneService) -> None:
    """What the server has read stays; what still lies in its sockets may be lost, and HEAD says where to go on."""
    data = random.Random(5).randbytes(300_000)
    path = _create(faces, "a.bin", len(data))
    stored = service._store.blobs.upload(path.rpartition("/")[2]) / "data"
    head = (
        f"PATCH {path} HTTP/1.1\r\nHost: localhost\r\nTus-Resumable: 1.0.0\r\nUpload-Offset: 0\r\n"
        f"Content-Type: application/offset+octet-stream\r\nContent-Length: {len(data)}\r\n\r\n"
    )
    deadline = time.monotonic() + 60
    with socket.create_connection(("127.0.0.1", faces.ports.http), timeout=20) as connection:
        connection.sendall(head.encode() + data[:100_000])
        while not (taken := stored.stat().st_size):
            assert time.monotonic() < deadline, "nothing arrived"
            time.sleep(0.01)
    offset, status = 0, 0
    while status != 204:  # until the server has noticed
        assert time.monotonic() < deadline, "the broken connection still holds the upload"
        offset = int(faces.rest.head(path, headers=TUS).headers["upload-offset"])
        status = _patch(faces, path, offset, data[offset:]).status_code
        assert status in (204, 409, 423)
    assert taken <= offset <= 100_000
    assert stored.read_bytes() == data


def test_checksums_are_kept_to(faces: Faces) -> None:
    path = _create(faces, "a.bin", 10)
    for name in ("sha1", "sha256"):
        wrong = base64.b64encode(hashlib.new(name, b"other").digest()).decode()
        refused = _patch(faces, path, 0, b"01234", **{"Upload-Checksum": f"{name} {wrong}"})
        assert refused.status_code == 460 and rest_refusal(refused).reason == "CHECKSUM_MISMATCH"
    right = base64.b64encode(hashlib.sha1(b"01234").digest()).decode()
    assert _patch(faces, path, 0, b"01234", **{"Upload-Checksum": f"sha1 {right}"}).status_code == 204
    for header in ("md5 abcd", "sha1", "sha1 ???"):
        assert _patch(faces, path, 5, b"56789", **{"Upload-Checksum": header}).status_code == 400
    assert faces.rest.head(path, headers=TUS).headers["upload-offset"] == "5"


@pytest.mark.parametrize(
    ("method", "headers", "status"),
    [
        ("PATCH", {}, 412),
        ("PATCH", {**PIECE, "Tus-Resumable": "0.2.2", "Upload-Offset": "0"}, 412),
        ("PATCH", {**TUS, "Content-Type": "application/json", "Upload-Offset": "0"}, 415),
        ("PATCH", {**PIECE}, 400),
        ("PATCH", {**PIECE, "Upload-Offset": "-1"}, 400),
        ("PATCH", {**PIECE, "Upload-Offset": "٣"}, 400),
        ("PATCH", {**PIECE, "Upload-Offset": "3"}, 409),
        ("HEAD", {}, 412),
        ("DELETE", {}, 412),
    ],
)
def test_what_is_not_tus_is_refused(faces: Faces, method: str, headers: dict[str, str], status: int) -> None:
    path = _create(faces, "a.bin", 4)
    sent = {name: value.encode() for name, value in headers.items()}
    answer = faces.rest.request(method, path, headers=sent, content=b"abcd" if method == "PATCH" else b"")
    assert answer.status_code == status and answer.headers["tus-resumable"] == "1.0.0"
    assert faces.rest.head(path, headers=TUS).headers["upload-offset"] == "0"


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Upload-Length": str(MAX_UPLOAD_BYTES + 1), **_name("a.zip")}, 413),
        ({"Upload-Defer-Length": "1", **_name("a.zip")}, 400),
        ({"Upload-Length": "4"}, 400),
        ({"Upload-Length": "4", **_name("../a.zip")}, 400),
        ({"Upload-Length": "4", "Upload-Metadata": "filename ???"}, 400),
        ({"Upload-Length": "4", "Upload-Metadata": f"filename {'A' * 5000}"}, 400),
    ],
)
def test_what_cannot_become_a_capture_is_refused_at_once(faces: Faces, headers: dict[str, str], status: int) -> None:
    answer = faces.rest.post("/v1/uploads", headers={**TUS, **headers})
    assert rest_refusal(answer).code == status and answer.headers["tus-resumable"] == "1.0.0"


def test_gone_is_gone(faces: Faces) -> None:
    path = _create(faces, "a.bin", 4)
    assert faces.rest.delete(path, headers=TUS).status_code == 204
    assert faces.rest.head(path, headers=TUS).status_code == 404
    assert _patch(faces, path, 0, b"abcd").status_code == 404
    assert faces.rest.delete(path, headers=TUS).status_code == 404
