"""Dropped answers are closed at once, within their call. Own process: a generator left to gRPC's GC may end it."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import grpc
import httpx
import pytest

from fastsplat.service.application.service import open_service
from fastsplat.service.settings import Settings
from fastsplat.service.store.rows.records import NewJob
from fastsplat_client import Client, Subscription
from fastsplat_client.stream import SceneServiceStub
from fastsplat_contract.codec.proto_codec import to_proto
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.made_scene import add_scene, turned
from tests.waiting import wait_for

_SERVE = """
import asyncio, sys
from fastsplat.api.server import serve
from fastsplat.service.application.service import open_service
from fastsplat.service.settings import Settings

async def main(service, settings):
    hooks = sys.get_asyncgen_hooks()
    def left(generator):
        if "fastsplat" in generator.ag_code.co_filename:
            print("left:", generator.ag_code.co_qualname, flush=True)
        hooks.finalizer(generator)
    sys.set_asyncgen_hooks(finalizer=left)
    ready = lambda ports: print("ready:", ports.http, ports.grpc, flush=True)
    await serve(service, settings, asyncio.Event(), ready)

settings = Settings.model_validate_json(sys.argv[1])
with open_service(settings) as service:
    asyncio.run(main(service, settings))
"""
_TIMES = 20
_LONG_FILE = 1 << 28  # more than any buffer on its way
_STREAMING = sorted(
    method.name for method in pb.DESCRIPTOR.services_by_name["SceneService"].methods if method.server_streaming
)


class _Server(NamedTuple):
    process: subprocess.Popen[bytes]
    log: Path
    scene_id: str

    @property
    def ports(self) -> tuple[str, str]:
        """HTTP's and gRPC's."""
        (line,) = [line for line in self.log.read_text().splitlines() if line.startswith("ready: ")]
        _, http, rpc = line.split()
        return http, rpc

    def check(self) -> None:
        """It lives, answers, and has left nothing to the garbage collector."""
        answer = httpx.get(f"http://127.0.0.1:{self.ports[0]}/v1/scenes", timeout=60)
        assert answer.status_code == 200 and self.process.poll() is None
        assert [line for line in self.log.read_text().splitlines() if line.startswith("left: ")] == []


@pytest.fixture(scope="module")
def server(api_settings: Settings, tmp_path_factory: pytest.TempPathFactory) -> Iterator[_Server]:
    settings = api_settings.model_copy(update={"data_dir": tmp_path_factory.mktemp("dropped")})
    with open_service(settings) as service:
        scene_id = add_scene(service, settings)
        os.truncate(service.photos.path(scene_id, "front.png")[0], _LONG_FILE)
        service._store.scenes.create(NewJob("queued", "queued", "", "", "", "queued", {}))
    log = settings.data_dir.with_suffix(".log")
    command = [sys.executable, "-c", _SERVE, settings.model_dump_json()]
    with log.open("w") as output:
        process = subprocess.Popen(command, stdout=output, stderr=output, cwd=Path(__file__).parents[3])
    try:
        running = _Server(process, log, scene_id)
        wait_for(lambda: "ready: " in log.read_text() or process.poll() is not None)
        assert process.poll() is None, log.read_text()
        yield running
    finally:
        process.kill()
        process.wait()


def _request(rpc: str, scene_id: str) -> Any:
    """One that is answered."""
    more: dict[str, dict[str, Any]] = {
        "DownloadPhoto": {"view": "front.png"},
        "ExportScene": {"format": pb.EXPORT_FORMAT_PLY},
        "Query": {"texts": ["mug", "ball"], "outputs": [pb.OUTPUT_MASK3D, pb.OUTPUT_OBJECTS]},
        "RenderView": {"kind": pb.PICTURE_KIND_RGB, "view": "front.png"},
    }
    if rpc == "WatchOperation":
        return pb.WatchOperationRequest(operation_id="queued")
    return getattr(pb, f"{rpc}Request")(scene_id=scene_id, **more.get(rpc, {}))


def _poses(scene_id: str) -> Iterator[pb.StreamQueryRequest]:
    question = pb.Subscription(query=pb.QueryRequest(scene_id=scene_id, texts=["mug"]), heartbeat_s=0.1)
    yield pb.StreamQueryRequest(question=question)
    for sequence in range(1, 100):
        yield pb.StreamQueryRequest(pose=pb.StreamPose(sequence=sequence, camera=to_proto(turned(0.01 * sequence))))


def _argument(rpc: str, scene_id: str) -> Any:
    return _poses(scene_id) if rpc == "StreamQuery" else _request(rpc, scene_id)


@pytest.mark.parametrize("rpc", _STREAMING)
def test_an_answer_over_grpc_is_dropped(server: _Server, rpc: str) -> None:
    """Read to its first message, then cancelled, or its connection cut: by the blocking client."""
    for turn in range(_TIMES):
        with grpc.insecure_channel(f"127.0.0.1:{server.ports[1]}") as channel:
            call = getattr(SceneServiceStub(channel), rpc)(_argument(rpc, server.scene_id), timeout=60)
            next(call)
            if turn % 2:
                call.cancel()
    server.check()


def test_streams_are_left_by_the_typed_client(server: _Server) -> None:
    http, rpc = server.ports
    question = Subscription(QueryRequest(server.scene_id, ("mug",), outputs=frozenset({"mask2d"})))
    with Client(f"http://127.0.0.1:{http}", grpc_target=f"127.0.0.1:{rpc}") as client:
        for _ in range(_TIMES):
            for _ in client.stream_query(question, (turned(0.01 * step) for step in range(100))):
                break
            for _ in client.watch("queued"):
                break
    server.check()


def test_events_are_dropped(server: _Server) -> None:
    url = f"http://127.0.0.1:{server.ports[0]}/v1/operations/queued/events"

    with httpx.Client(timeout=60) as client:
        for _ in range(_TIMES):
            with client.stream("GET", url) as answer, closing(answer.iter_raw()) as pieces:
                assert b"event: operation" in next(pieces)
    server.check()
