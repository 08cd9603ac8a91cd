"""Dropped answers are closed at once, within their call. Own process: a generator left to gRPC's GC may end it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import closing
from typing import Any

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
from tests.api.server_process import ServerProcess, server_process

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
    def ready(ports):
        print(f"HTTP on http://127.0.0.1:{ports.http}, gRPC on 127.0.0.1:{ports.grpc}", flush=True)
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


def _check(server: ServerProcess) -> None:
    """It lives, answers, and has left nothing to the garbage collector."""
    assert httpx.get(f"{server.url}/v1/scenes", timeout=60).status_code == 200 and server.process.poll() is None
    assert "\nleft: " not in server.log.read_text()


@pytest.fixture(scope="module")
def place(api_settings: Settings, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[ServerProcess, str]]:
    """A server, and a scene of it."""
    settings = api_settings.model_copy(update={"data_dir": tmp_path_factory.mktemp("dropped")})
    with open_service(settings) as service:
        scene_id = add_scene(service, settings)
        os.truncate(service.photos.path(scene_id, "front.png")[0], _LONG_FILE)
        service._store.scenes.create(NewJob("queued", "queued", "", "", "", "queued", {}))
    with server_process(settings, _SERVE) as server:
        yield server, scene_id


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


@pytest.mark.parametrize("rpc", _STREAMING)
def test_an_answer_over_grpc_is_dropped(place: tuple[ServerProcess, str], rpc: str) -> None:
    """Read to its first message, then cancelled, or its connection cut: by the blocking client."""
    server, scene_id = place
    for turn in range(_TIMES):
        with grpc.insecure_channel(server.grpc_target) as channel:
            sent = _poses(scene_id) if rpc == "StreamQuery" else _request(rpc, scene_id)
            call = getattr(SceneServiceStub(channel), rpc)(sent, timeout=60)
            next(call)
            if turn % 2:
                call.cancel()
    _check(server)


def test_streams_are_left_by_the_typed_client(place: tuple[ServerProcess, str]) -> None:
    server, scene_id = place
    question = Subscription(QueryRequest(scene_id, ("mug",), outputs=frozenset({"mask2d"})))
    with Client(server.url, grpc_target=server.grpc_target) as client:
        for _ in range(_TIMES):
            for _ in client.stream_query(question, (turned(0.01 * step) for step in range(100))):
                break
            for _ in client.watch("queued"):
                break
    _check(server)


def test_events_are_dropped(place: tuple[ServerProcess, str]) -> None:
    server, _ = place
    url = f"{server.url}/v1/operations/queued/events"
    with httpx.Client(timeout=60) as client:
        for _ in range(_TIMES):
            with client.stream("GET", url) as answer, closing(answer.iter_raw()) as pieces:
                assert b"event: operation" in next(pieces)
    _check(server)
