"""A folder travels as the capture that it is, one open file at a time."""

from __future__ import annotations

import email.parser
import email.policy
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from fastsplat_client import Client, InvalidInputError, QueryRequest, Retry, Subscription
from fastsplat_client.captures import CaptureFiles
from tests.client.scripted import FINE, Scripted, problem, scripted

_SENT = {
    "images/0001.jpg": b"photo",
    "images/more/0002.PNG": b"photo, too",
    "images/0003.heic": b"photo of a phone",
    "images/0004.gif": b"the server says what to do",
    "rgbd/0.depth": b"depth map",
    "metadata": b"{}",
    "masks/0001.png": b"mask",
    "labels/0001.png": b"label map",
    "labels.json": b"{}",
    "transforms.json": b"{}",
    "points3d.ply": b"ply",
    "sparse/0/cameras.bin": b"model",
    "sparse/0/images.bin": b"model",
    "sparse/0/points3D.txt": b"model",
}
_LEFT = (
    "notes.txt",
    ".hidden.jpg",
    "Thumbs.db",
    "__MACOSX/images/0001.jpg",
    ".git/config.json",
    "sparse/0/project.ini",
)
_MANY = """
import resource, sys
from pathlib import Path
from fastsplat_client import Client
resource.setrlimit(resource.RLIMIT_NOFILE, (1024, 1024))
with Client(sys.argv[1]) as client:
    print(client.create_scene(Path(sys.argv[2])).id)
"""


@pytest.fixture
def server() -> Iterator[Scripted]:
    with scripted() as running:
        yield running


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, content in {**_SENT, **dict.fromkeys(_LEFT, b"left")}.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(content)
    return tmp_path


def _parts(server: Scripted, request: int = -1) -> dict[tuple[str, str], bytes]:
    """Field and file name of each part of a request, the last by default, with its bytes."""
    _, headers, body = server.seen[request]
    head = f"Content-Type: {headers['content-type']}\r\n\r\n".encode()
    message = email.parser.BytesParser(policy=email.policy.HTTP).parsebytes(head + body)
    parts: dict[tuple[str, str], bytes] = {}
    for part in message.iter_parts():
        field = str(part.get_param("name", header="content-disposition"))
        parts[field, part.get_filename() or ""] = part.get_payload(decode=True)
    return parts


def test_all_that_belongs_to_a_capture_travels_under_its_name(server: Scripted, folder: Path) -> None:
    server.script = [problem(503, "UNAVAILABLE"), FINE]
    with Client(server.url, retry=Retry(first_s=0.01)) as client:
        client.create_scene(folder, name="desk")
    parts = _parts(server)
    assert parts == _parts(server, 0) and len(parts["request_id", ""]) == 32, "repeated whole under one id"
    assert {name: content for (field, name), content in parts.items() if field == "files"} == _SENT
    assert parts["name", ""] == b"desk"
    assert {field for field, _ in parts} == {"name", "request_id", "files"}


def test_a_folder_without_pictures_is_said_before_anything_is_sent(server: Scripted, tmp_path: Path) -> None:
    (tmp_path / "transforms.json").write_bytes(b"{}")
    with Client(server.url) as client, pytest.raises(InvalidInputError, match="no photos, no video and no splat"):
        client.create_scene(tmp_path)
    with Client(server.url) as client, pytest.raises(InvalidInputError):
        client.create_scene(tmp_path / "none")
    assert server.seen == []


def test_more_files_than_may_be_open_travel(server: Scripted, tmp_path: Path) -> None:
    for number in range(1_100):
        (tmp_path / f"{number:04d}.jpg").write_bytes(b"photo %d" % number)
    server.script = [FINE]
    done = subprocess.run(
        [sys.executable, "-c", _MANY, server.url, tmp_path], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0 and done.stdout.strip() == "o", done.stderr
    files = {name: content for (field, name), content in _parts(server).items() if field == "files"}
    assert len(files) == 1_100 and files["1099.jpg"] == b"photo 1099"


def test_files_are_closed_again(folder: Path) -> None:
    with CaptureFiles(folder) as files:
        late = [file for field, (_, file, *_) in files.form([]) if field == "files"]
        assert [file.seek(0, 2) for file in late] == [len(_SENT[name]) for name in sorted(_SENT, key=Path)]
        for file in late:
            while file.read(3):
                pass
            assert file._file is None
        late[0].read(1)
    assert late[0]._file is None


def test_the_key_goes_to_no_address_that_nobody_named(server: Scripted, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []

    def refuse(target: str) -> None:
        opened.append(target)
        raise AssertionError(target)

    monkeypatch.setattr("fastsplat_client.stream.grpc.insecure_channel", refuse)
    question = Subscription(QueryRequest("s", ("mug",)))
    with Client(server.url, key="secret", retry=Retry(tries=1)) as client:
        server.script = [(200, {}, b'{"version": "1", "grpc": null}')]
        with pytest.raises(InvalidInputError, match="does not say") as caught:
            list(client.stream_query(question, []))
        assert caught.value.field == "grpc_target" and not opened
        server.script = [(200, {}, b'{"version": "1", "grpc": ":4711"}')]
        with pytest.raises(AssertionError):
            list(client.stream_query(question, []))
        assert opened == ["127.0.0.1:4711"]
    with Client(server.url, key="secret", grpc_target="robots.example:9") as client, pytest.raises(AssertionError):
        client.ask(QueryRequest("s", ("mug",)), protocol="gRPC")
    assert opened[-1] == "robots.example:9" and len(server.seen) == 2
