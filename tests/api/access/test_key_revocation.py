"""Whatever a key has under way ends within two looks (`Authenticator.FRESH_S`) of the key, over both ports."""

from __future__ import annotations

import asyncio
import json
import os
import queue
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import grpc
import httpx
import pytest

from fastsplat.api.access.authenticator import Authenticator, Credentials
from fastsplat.api.access.caller import Principal
from fastsplat.api.access.policy import rule_of
from fastsplat.service.application.admin.keys import KeyRing, key_id_of
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import Settings
from fastsplat.service.store.repositories.key_repository import KeyRecord
from fastsplat.service.store.rows.records import NewJob
from fastsplat_client.transport import events_of
from fastsplat_contract.errors import DatabaseError, UnauthenticatedError
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.made_scene import add_scene
from tests.api.served import Faces, rpc_refusal, served
from tests.at_once import on_a_loop
from tests.waiting import wait_for, with_growing_limit

_LONG_FILE = 1 << 28  # more than any buffer on its way


@dataclass(frozen=True)
class _Place:
    faces: Faces
    service: SceneService
    scene_id: str
    operation_id: str

    def key(self, lifetime_s: float | None = None) -> tuple[str, str]:
        record, key = self.service.admin.keys.create("brief", "editor", lifetime_s)
        return record.id, key


@pytest.fixture(scope="module")
def place(api_settings: Settings, tmp_path_factory: pytest.TempPathFactory) -> Iterator[_Place]:
    settings = api_settings.model_copy(update={"auth": "on", "data_dir": tmp_path_factory.mktemp("revoked")})
    with open_service(settings) as service, served(service, settings) as faces:
        scene_id = add_scene(service, settings)
        for file in (service.answers.scene_ply(scene_id)[0], service.photos.path(scene_id, "front.png")[0]):
            os.truncate(file, _LONG_FILE)
        service._store.scenes.create(NewJob("queued", "queued", "", "", "", "queued", {}))
        yield _Place(faces, service, scene_id, "queued")


_Ended = Callable[[], str]
"""Waits for the end of a call that has begun and would go on for long; returns the reason, "" if there is none."""


def _rpc(begin: Callable[[_Place, Any], Any], read: Callable[[Any], Any] = list) -> Callable[[_Place, str], _Ended]:
    def start(place: _Place, key: str) -> _Ended:
        call = begin(place, (("authorization", f"Bearer {key}"),))

        def ended() -> str:
            with pytest.raises(grpc.RpcError) as caught:
                read(call)
            refusal = rpc_refusal(caught.value)
            assert refusal.code == "UNAUTHENTICATED"
            return refusal.reason

        return ended

    return start


def _stream_query(place: _Place, metadata: Any) -> Any:
    requests: queue.Queue[Any] = queue.Queue()
    question = pb.Subscription(query=pb.QueryRequest(scene_id=place.scene_id, texts=["mug"]), heartbeat_s=0.1)
    requests.put(pb.StreamQueryRequest(question=question))
    call = place.faces.rpc.StreamQuery(iter(requests.get, None), metadata=metadata, timeout=30)
    assert next(call).WhichOneof("part") == "accepted" and next(call).WhichOneof("part") == "heartbeat"
    return call


def _watch(place: _Place, metadata: Any) -> Any:
    call = place.faces.rpc.WatchOperation(
        pb.WatchOperationRequest(operation_id=place.operation_id), metadata=metadata, timeout=30
    )
    assert next(call).state == pb.OPERATION_STATE_QUEUED
    return call


def _download(place: _Place, metadata: Any) -> Any:
    call = place.faces.rpc.DownloadPhoto(
        pb.DownloadPhotoRequest(scene_id=place.scene_id, view="front.png"), metadata=metadata, timeout=30
    )
    assert len(next(call).data)

    def slowly() -> Iterator[Any]:
        for chunk in call:
            time.sleep(0.1)
            yield chunk

    return slowly()


def _upload(place: _Place, metadata: Any) -> Any:
    requests: queue.Queue[Any] = queue.Queue()
    requests.put(pb.CreateSceneRequest(header=pb.CreateSceneHeader()))
    requests.put(pb.CreateSceneRequest(file=pb.FileHeader(name="a.jpg")))
    requests.put(pb.CreateSceneRequest(chunk=b"a"))
    call = place.faces.rpc.CreateScene.future(iter(requests.get, None), metadata=metadata, timeout=30)
    wait_for(lambda: _uploads(place) > 0)
    return call


def _rest(head: Callable[[_Place], str], *, begins: bool) -> Callable[[_Place, str], _Ended]:
    """A request by its head; `begins`: it is answered, and the answer then goes on."""

    def start(place: _Place, key: str) -> _Ended:
        connection = socket.create_connection(("127.0.0.1", place.faces.ports.http), timeout=20)
        lines = head(place).replace("\n", "\r\n", 1).split("\r\n", 1)
        more = f"Host: localhost\r\nConnection: close\r\nAuthorization: Bearer {key}\r\n"
        connection.sendall(f"{lines[0]}\r\n{more}{lines[1]}".encode())
        answer = connection.makefile("rb")
        if begins:
            assert answer.readline().split()[1] == b"200"
        elif "POST" in lines[0]:
            wait_for(lambda: _uploads(place) > 0)
        else:
            time.sleep(0.3)

        def ended() -> str:
            with connection, answer:
                if begins:
                    total = 0
                    while piece := answer.read1(1 << 16):
                        total += len(piece)
                        assert total < _LONG_FILE and not piece.endswith(b"0\r\n\r\n"), "it ended as if it were whole"
                        time.sleep(0.005)
                    return ""
                assert answer.readline().split()[1] == b"401"
                return "UNAUTHENTICATED" if b'"UNAUTHENTICATED"' in answer.read() else "?"

        return ended

    return start


def _events(place: _Place, key: str) -> _Ended:
    """Server-sent events end as a whole answer, with an event that says why."""
    client = httpx.Client(base_url=place.faces.rest.base_url, headers={"Authorization": f"Bearer {key}"}, timeout=30)
    answer = client.send(client.build_request("GET", f"/v1/operations/{place.operation_id}/events"), stream=True)
    assert answer.status_code == 200

    def ended() -> str:
        with closing(client), closing(answer):
            *_, last = events_of(answer.iter_lines())  # httpx raises where an answer is cut off
        assert last.kind == "error"
        problem = json.loads(last.data)
        assert problem["status"] == 401 and problem["request_id"] == answer.headers["x-request-id"]
        return str(problem["reason"])

    return ended


_BODY = "Content-Type: multipart/form-data; boundary=x\r\nContent-Length: 2000\r\n\r\n"
_PART = '--x\r\nContent-Disposition: form-data; name="images"; filename="a.jpg"\r\n\r\nabc'


def _piece(place: _Place) -> str:
    upload = place.service.resumable.create("default", "a.zip", 2000)
    return (
        f"PATCH /v1/uploads/{upload.id} HTTP/1.1\nTus-Resumable: 1.0.0\r\nUpload-Offset: 0\r\n"
        "Content-Type: application/offset+octet-stream\r\nContent-Length: 2000\r\n\r\nabc"
    )


_CALLS: dict[str, Callable[[_Place, str], _Ended]] = {
    "gRPC StreamQuery": _rpc(_stream_query),
    "gRPC WatchOperation": _rpc(_watch),
    "gRPC DownloadPhoto": _rpc(_download),
    "gRPC CreateScene": _rpc(_upload, read=lambda call: call.result()),
    "REST events": _events,
    "REST wait": _rest(
        lambda place: f"GET /v1/operations/{place.operation_id}:wait?timeout_s=200 HTTP/1.1\n\r\n", begins=False
    ),
    "REST scene.ply": _rest(lambda place: f"GET /v1/scenes/{place.scene_id}/scene.ply HTTP/1.1\n\r\n", begins=True),
    "REST POST scenes": _rest(lambda place: f"POST /v1/scenes HTTP/1.1\n{_BODY}{_PART}", begins=False),
    "REST PATCH upload": _rest(_piece, begins=False),
}


def _uploads(place: _Place) -> int:
    return len(list(Path(place.service._store.blobs.root / "uploads").glob("*/raw/*")))


_EXPIRING = ("gRPC CreateScene", "REST events")


def _begun(place: _Place, begin: Callable[[_Place, str], _Ended], lifetime_s: float) -> tuple[str, _Ended] | None:
    """A key that expires, and a call that has begun with it; None where it expired before."""
    _, key = place.key(lifetime_s=lifetime_s)
    try:
        return key, begin(place, key)
    except (AssertionError, grpc.RpcError):
        if _status(place, key) == 200:
            raise
        return None


def _status(place: _Place, key: str) -> int:
    """What a request with this key is answered."""
    return httpx.get(
        f"{place.faces.rest.base_url}/v1/scenes", headers={"Authorization": f"Bearer {key}"}, timeout=60
    ).status_code


@pytest.mark.parametrize(
    ("call", "expires"), [*((call, False) for call in _CALLS), *((call, True) for call in _EXPIRING)]
)
def test_a_call_ends_with_its_key_and_others_go_on(place: _Place, call: str, expires: bool) -> None:
    _, secret = place.key()
    watching = _watch(place, (("authorization", f"Bearer {secret}"),))
    begin = _CALLS[call]
    if expires:
        key, running = with_growing_limit(lambda lifetime_s: _begun(place, begin, lifetime_s), 2.0)
    else:
        key_id, key = place.key()
        running = begin(place, key)
        place.service.admin.keys.revoke(key_id)
    assert running() == ("" if call == "REST scene.ply" else "UNAUTHENTICATED")
    wait_for(lambda: _uploads(place) == 0)  # an upload that was cut leaves nothing
    assert watching.is_active()
    watching.cancel()
    assert _status(place, key) == 401


@on_a_loop
async def test_the_keys_are_read_once_for_all_calls_under_way_and_a_silent_database_ends_none() -> None:
    valid = KeyRecord("0" * 12, "robot", "reader", "0" * 64, 0.0)
    reads: list[float] = []

    class _Ring(KeyRing):
        def find(self, key: str) -> KeyRecord | None:
            return valid

    def load() -> KeyRing:
        reads.append(time.monotonic())
        if len(reads) == 2:
            raise DatabaseError("it does not answer")
        return _Ring({valid.id: valid} if len(reads) < 4 else {})

    authenticator = Authenticator(load, auth_enabled=True)
    rule = rule_of("GET /v1/scenes")

    async def call() -> str:
        principal = await authenticator.authenticate(Credentials("fsk"), rule)
        assert principal is not None
        try:
            with authenticator.watch(principal):
                await asyncio.Event().wait()
        except UnauthenticatedError as error:
            return error.message
        raise AssertionError

    ends = await asyncio.gather(*(call() for _ in range(50)))
    assert len(ends) == 50 and len(reads) == 4
    assert Authenticator.FRESH_S <= 1


@pytest.mark.parametrize("new", ["key", "project"])
@on_a_loop
async def test_what_is_made_while_the_keys_are_read_is_known_at_once(new: str) -> None:
    """A call must not take a reading for its own that began before the call: it may lack what was made meanwhile."""
    old, fresh, unknown = (f"fsk_{digit * 12}_{'s' * 43}" for digit in "123")
    keys, projects = {key_id_of(old)}, {"default"}
    readings = count()
    begun, go_on = threading.Event(), threading.Event()

    class _Ring(KeyRing):
        def find(self, key: str) -> KeyRecord | None:
            return self._by_id.get(key_id_of(key))

    def load() -> KeyRing:
        ring = _Ring(
            {key_id: KeyRecord(key_id, "name", "operator", "0" * 64, 0.0) for key_id in keys}, frozenset(projects)
        )
        if next(readings) == 1:
            begun.set()
            assert go_on.wait(60)
        return ring

    authenticator = Authenticator(load, auth_enabled=True)

    async def call(key: str, project: str = "") -> Principal | None:
        return await authenticator.authenticate(Credentials(key, project), rule_of("GET /v1/scenes"))

    await call(old)
    looks_again = asyncio.create_task(call(unknown))
    await asyncio.to_thread(begun.wait)
    keys.add(key_id_of(fresh))
    projects.add("new")
    late = asyncio.create_task(call(fresh) if new == "key" else call(old, "new"))
    for _ in range(3):
        await asyncio.sleep(0)  # it has come to where it waits for a reading, and one is under way
    go_on.set()
    with pytest.raises(UnauthenticatedError):
        await looks_again
    assert await late is not None


@on_a_loop
async def test_a_task_that_others_cancel_is_cancelled() -> None:
    valid = KeyRecord("0" * 12, "robot", "reader", "0" * 64, 0.0)
    authenticator = Authenticator(lambda: KeyRing({valid.id: valid}), auth_enabled=False)
    principal = await authenticator.authenticate(Credentials(""), rule_of("GET /v1/scenes"))
    assert principal is not None and principal.role == "operator"

    async def call() -> None:
        with authenticator.watch(principal):
            await asyncio.Event().wait()

    task = asyncio.create_task(call())
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
