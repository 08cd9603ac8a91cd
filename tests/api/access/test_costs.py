"""What a request costs is bounded before it is paid, alike on both protocols; nobody's work starves another's."""

from __future__ import annotations

import asyncio
import http.client
import threading
from collections.abc import Iterator
from typing import Any

import grpc
import pytest

from fastsplat.api.fair_pool import FairPool
from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import LimitSettings, Settings, UploadSettings
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.codec.proto_codec import to_proto
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.messages.scenes import Color, Edit, SceneVersion
from fastsplat_contract.photos.pictures import PictureRequest
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.made_scene import turned
from tests.api.served import EndlessQuestions, Faces, Refusal, rest_refusal, rpc_refusal, served


def _refused(faces: Faces, request: QueryRequest, protocol: str) -> Refusal:
    if protocol == "gRPC":
        with pytest.raises(grpc.RpcError) as caught:
            list(faces.rpc.Query(to_proto(request)))
        return rpc_refusal(caught.value)
    body = {name: value for name, value in to_plain(request).items() if name != "scene_id"}
    return rest_refusal(faces.rest.post(f"/v1/scenes/{request.scene_id}:query", json=body))


@pytest.mark.parametrize("protocol", ["REST", "gRPC"])
def test_too_many_sentences_or_pixels_are_refused_before_any_work(
    faces: Faces, service: SceneService, scene_id: str, protocol: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[Any] = []
    monkeypatch.setattr(service._context.scenes, "open", lambda *arguments: opened.append(arguments))
    templates = tuple(f"{{}} number {number}" for number in range(64))
    texts = tuple(f"object {number}" for number in range(64))
    encodings = _refused(faces, QueryRequest(scene_id, texts, templates=templates), protocol)
    assert (encodings.reason, encodings.details["field"]) == ("LIMIT_EXCEEDED", "templates")
    posed = turned(0.0)
    large = type(posed)(posed.camera.scaled_to(4000, 3000), posed.world_from_camera)
    question = QueryRequest(scene_id, ("mug",), (large,) * 64, outputs=frozenset({"mask2d"}))
    pixels = _refused(faces, question, protocol)
    assert (pixels.reason, pixels.details["field"]) == ("LIMIT_EXCEEDED", "cameras")
    assert pixels.details["limit"] == f"{2**27} pixels" and not opened


@pytest.mark.parametrize("protocol", ["REST", "gRPC"])
def test_the_server_itself_ends_what_takes_too_long(
    service: SceneService, api_settings: Settings, scene_id: str, protocol: str
) -> None:
    limits = LimitSettings(answer_s=0.2)
    with served(EndlessQuestions(service), api_settings.model_copy(update={"limits": limits})) as faces:
        refusal = _refused(faces, QueryRequest(scene_id, ("mug",)), protocol)
    assert refusal.reason == "DEADLINE_EXCEEDED" and refusal.code in (504, "DEADLINE_EXCEEDED")
    assert refusal.details["limit"] == "0.2 s"


@pytest.fixture
def impatient(service: SceneService, api_settings: Settings) -> Iterator[Faces]:
    """A server that waits half a second for a sender."""
    with served(service, api_settings.model_copy(update={"uploads": UploadSettings(slow_start_s=0.5)})) as faces:
        yield faces


def _begin_upload(faces: Faces) -> http.client.HTTPConnection:
    """A form that never comes to its end."""
    connection = http.client.HTTPConnection("127.0.0.1", faces.ports.http, timeout=60)
    connection.putrequest("POST", "/v1/scenes")
    connection.putheader("Content-Type", "multipart/form-data; boundary=x")
    connection.putheader("Content-Length", "100000")
    connection.endheaders(b"--x\r\n")
    return connection


def test_a_sender_that_drips_is_cut_off(impatient: Faces) -> None:
    connection = _begin_upload(impatient)
    over = threading.Event()

    def drip() -> None:
        while not over.wait(0.1):
            try:
                connection.sock.sendall(b"C")
            except OSError:
                return

    dripping = threading.Thread(target=drip)
    dripping.start()
    try:
        response = connection.getresponse()
        assert response.status == 504 and b"DEADLINE_EXCEEDED" in response.read()
    finally:
        over.set()
        dripping.join(30)
        connection.close()


def test_a_stream_that_is_silent_is_cut_off(impatient: Faces) -> None:
    silent = threading.Event()

    def messages() -> Iterator[pb.CreateSceneRequest]:
        yield pb.CreateSceneRequest(header=pb.CreateSceneHeader(name="x"))
        silent.wait(60)

    with pytest.raises(grpc.RpcError) as caught:
        impatient.rpc.CreateScene(messages())
    silent.set()
    assert rpc_refusal(caught.value).reason == "DEADLINE_EXCEEDED"


@pytest.mark.parametrize("protocol", ["REST", "gRPC"])
def test_what_renders_runs_where_it_holds_up_no_question(
    faces: Faces, service: SceneService, scene_id: str, protocol: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    threads: list[str] = []
    real = service._context.scenes.open

    def noting(*arguments: Any) -> Any:
        threads.append(threading.current_thread().name.rpartition("_")[0])
        return real(*arguments)

    monkeypatch.setattr(service._context.scenes, "open", noting)
    question = QueryRequest(scene_id, ("mug",))
    masked = QueryRequest(scene_id, ("mug",), (turned(0.0),), outputs=frozenset({"mask2d"}))
    picture = PictureRequest(scene_id, "rgb", camera=turned(0.0))
    if protocol == "REST":
        for request in (question, masked):
            body = {name: value for name, value in to_plain(request).items() if name != "scene_id"}
            faces.rest.post(f"/v1/scenes/{scene_id}:query", json=body).raise_for_status()
        body = {name: value for name, value in to_plain(picture).items() if name != "scene_id"}
        faces.rest.post(f"/v1/scenes/{scene_id}:render", json=body).raise_for_status()
    else:
        for call, sent in ((faces.rpc.Query, question), (faces.rpc.Query, masked), (faces.rpc.RenderView, picture)):
            list(call(to_proto(sent)))
    assert threads == ["call", "call_background", "call_background"]


def test_an_edit_that_waits_for_another_one_has_no_thread(
    service: SceneService, api_settings: Settings, fresh_id: str
) -> None:
    edit = Edit("recolor", label="mug", color=Color(0.1, 0.2, 0.3))

    async def main() -> tuple[str, SceneVersion]:
        threads = Threads(LimitSettings(threads=1))
        try:
            with service._store.workers.exclusive(f"edit {fresh_id}", 30.0):
                waiting = asyncio.ensure_future(threads.call(lambda: service.versions.edit(fresh_id, [edit])))
                answers = [await threads.call(lambda: "answered") for _ in range(10) if not await asyncio.sleep(0.02)]
                assert not waiting.done()
            return answers[-1], await waiting
        finally:
            await asyncio.to_thread(threads.close)

    answer, version = asyncio.run(asyncio.wait_for(main(), 120))
    assert answer == "answered" and version.edits == (edit,)


def test_a_caller_has_a_smaller_share_while_another_calls() -> None:
    now = [0.0]
    pool = FairPool(8, "share", clock=lambda: now[0])
    release, begun = threading.Event(), threading.Semaphore(0)

    def work() -> None:
        begun.release()
        assert release.wait(60)

    def begin(count: int) -> int:
        return sum(begun.acquire(timeout=60.0 if number < count else 0.2) for number in range(count + 1))

    pool.submit("quiet", lambda: None).result(60)
    for _ in range(16):
        pool.submit("loud", work)
    assert begin(2) == 2  # of 8 threads, with two callers
    now[0] = 60.0  # nobody else has called for a while
    pool.submit("loud", work)
    assert begin(5) == 5  # all but one, those two included
    release.set()
    pool.close()
