"""A signal while uploads come in: the server stops in its grace, keeps what it acknowledged, leaves nothing else."""

from __future__ import annotations

import base64
import os
import random
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import grpc
import httpx

from fastsplat.service.application.service import open_service
from fastsplat.service.settings import Settings
from fastsplat_client.stream import SceneServiceStub
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.served import serving
from tests.waiting import wait_for

_SERVE = """
import logging, sys
from pathlib import Path
from fastsplat.api.server import run
from fastsplat.service.settings import Settings
logging.basicConfig(level=logging.INFO)
run(Settings(data_dir=Path(sys.argv[1]), http_port=0, grpc_port=0, metrics_port=0, auth="off", drain_s=1.0))
"""
_TUS = {"Tus-Resumable": "1.0.0"}


class _Server:
    def __init__(self, process: subprocess.Popen[str], http_port: str, grpc_port: str) -> None:
        self.process = process
        self.address = ("127.0.0.1", int(http_port))
        self.url = f"http://127.0.0.1:{http_port}"
        self.grpc_target = f"127.0.0.1:{grpc_port}"


@contextmanager
def _server(data_dir: Path) -> Iterator[_Server]:
    log = data_dir.with_suffix(".log")
    with log.open("w") as stderr:
        process = subprocess.Popen(
            [sys.executable, "-c", _SERVE, str(data_dir)],
            stderr=stderr,
            text=True,
            cwd=Path(__file__).parents[3],
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )
    try:
        ports: list[re.Match[str]] = []

        def listens() -> bool:
            assert process.poll() is None, log.read_text()
            ports.extend(re.finditer(r"HTTP on http://127\.0\.0\.1:(\d+), gRPC on 127\.0\.0\.1:(\d+)", log.read_text()))
            return bool(ports)

        wait_for(listens)
        yield _Server(process, ports[0][1], ports[0][2])
    finally:
        process.kill()
        process.wait()


def _answer(connection: socket.socket) -> bytes:
    """What the server says before it closes."""
    received = b""
    try:
        while piece := connection.recv(10_000):
            received += piece
    except ConnectionResetError:
        pass
    return received


def test_a_signal_in_mid_upload(tmp_path: Path) -> None:
    """SIGINT; for SIGTERM, see test_api_server."""
    data = random.Random(9).randbytes(200_000)
    acknowledged = 50_000
    root = tmp_path / "data" / "uploads"
    with _server(tmp_path / "data") as server:
        name = base64.b64encode(b"capture.zip").decode()
        headers = {**_TUS, "Upload-Length": str(len(data)), "Upload-Metadata": f"filename {name}"}
        path = httpx.post(f"{server.url}/v1/uploads", headers=headers, timeout=60).headers["location"]
        _append(server.url + path, 0, data[:acknowledged])
        stored = root / path.rpartition("/")[2] / "data"
        head = (
            f"PATCH {path} HTTP/1.1\r\nHost: localhost\r\nTus-Resumable: 1.0.0\r\nUpload-Offset: {acknowledged}\r\n"
            f"Content-Type: application/offset+octet-stream\r\nContent-Length: {len(data) - acknowledged}\r\n\r\n"
        )
        form = (
            "POST /v1/scenes HTTP/1.1\r\nHost: localhost\r\nContent-Type: multipart/form-data; boundary=x\r\n"
            "Content-Length: 1000000\r\n\r\n"
            '--x\r\nContent-Disposition: form-data; name="images"; filename="a.jpg"\r\n\r\n'
        )

        def messages() -> Iterator[pb.CreateSceneRequest]:
            yield pb.CreateSceneRequest(header=pb.CreateSceneHeader())
            yield pb.CreateSceneRequest(file=pb.FileHeader(name="b.jpg"))
            yield pb.CreateSceneRequest(chunk=data[:70_000])
            server.process.wait(60)

        with (
            socket.create_connection(server.address, timeout=60) as piece,
            socket.create_connection(server.address, timeout=60) as scene,
            grpc.insecure_channel(server.grpc_target) as channel,
        ):
            piece.sendall(head.encode() + data[acknowledged : acknowledged + 70_000])
            scene.sendall(form.encode() + data[:70_000])
            over_grpc = SceneServiceStub(channel).CreateScene.future(messages())
            wait_for(lambda: stored.stat().st_size > acknowledged and len(list(root.glob("*/raw/*.jpg"))) == 2)
            server.process.send_signal(signal.SIGINT)
            answers = [_answer(piece), _answer(scene)]
            assert over_grpc.exception(60).code() in (grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.CANCELLED)
            assert server.process.wait(30) == 0
        for answer in answers:
            assert not answer or (answer.startswith(b"HTTP/1.1 503") and b"application/problem+json" in answer)
    assert "Traceback" not in (tmp_path / "data.log").read_text()
    assert [folder.name for folder in root.iterdir()] == [stored.parent.name]  # of the forms nothing is left

    settings = Settings(data_dir=tmp_path / "data", http_port=0, grpc_port=0, metrics_port=0, auth="off")
    with open_service(settings) as service, serving(service, settings) as ports:
        url = f"http://127.0.0.1:{ports.http}{path}"
        offset = int(httpx.head(url, headers=_TUS, timeout=60).headers["upload-offset"])
        assert acknowledged <= offset <= acknowledged + 70_000
        _append(url, offset, data[offset:])
        assert stored.read_bytes() == data


def _append(url: str, offset: int, data: bytes) -> None:
    headers = {**_TUS, "Upload-Offset": str(offset), "Content-Type": "application/offset+octet-stream"}
    response = httpx.patch(url, content=data, headers=headers, timeout=60)
    assert response.status_code == 204, response.text
    assert response.headers["upload-offset"] == str(offset + len(data))
