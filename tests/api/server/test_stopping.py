"""A signal while uploads come in: the server stops in its grace, keeps what it acknowledged, leaves nothing else."""

from __future__ import annotations

import random
import signal
import socket
from collections.abc import Iterator
from pathlib import Path

import grpc
import httpx

from fastsplat.service.application.service import open_service
from fastsplat_client.stream import SceneServiceStub
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.served import on_free_ports, serving
from tests.api.server_process import server_process
from tests.api.uploaded import PIECE, TUS, announced
from tests.waiting import wait_for


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
    settings = on_free_ports(data_dir=tmp_path / "data", drain_s=1.0)
    with server_process(settings) as server:
        headers = announced("capture.zip", len(data))
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
            socket.create_connection(("127.0.0.1", server.http_port), timeout=60) as piece,
            socket.create_connection(("127.0.0.1", server.http_port), timeout=60) as scene,
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
    assert "Traceback" not in server.log.read_text()
    assert [folder.name for folder in root.iterdir()] == [stored.parent.name]  # of the forms nothing is left

    with open_service(settings) as service, serving(service, settings) as ports:
        url = f"http://127.0.0.1:{ports.http}{path}"
        offset = int(httpx.head(url, headers=TUS, timeout=60).headers["upload-offset"])
        assert acknowledged <= offset <= acknowledged + 70_000
        _append(url, offset, data[offset:])
        assert stored.read_bytes() == data


def _append(url: str, offset: int, data: bytes) -> None:
    response = httpx.patch(url, content=data, headers={**PIECE, "Upload-Offset": str(offset)}, timeout=60)
    assert response.status_code == 204, response.text
    assert response.headers["upload-offset"] == str(offset + len(data))
