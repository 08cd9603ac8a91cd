"""Operations by list, wait and events, alike on both faces; a scene's labels in pages."""

from __future__ import annotations

import itertools
import json
import threading
from collections.abc import Iterator
from dataclasses import replace

import grpc
import pytest

from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import Settings
from fastsplat_client import Client, DeadlineExceededError
from fastsplat_client.transport import Event, events_of
from fastsplat_contract.codec.proto_codec import to_proto
from fastsplat_contract.errors import NotFoundError
from fastsplat_contract.jobs.operations import Operation
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.clients import client_of
from tests.api.served import Faces, rest_refusal, rpc_refusal, served
from tests.scenes import queued_job


@pytest.fixture
def queued(service: SceneService) -> Iterator[str]:
    """A job that no worker takes."""
    job = queued_job()
    service._store.scenes.create(job)
    yield job.operation_id
    service.delete_scene(job.scene_id)


def _advance(service: SceneService, operation_id: str, fractions: list[float]) -> None:
    """What a worker does to a job until it has trained it."""
    claim = service._store.jobs.claim(operation_id)
    assert claim is not None
    for fraction in fractions:
        stage = {"stage": "training", "fraction": fraction, "message": "", "seconds": fraction, "metrics": {}}
        service._store.jobs.report(claim, [stage])


def test_events_tell_every_change_until_the_job_is_done(client: Client, service: SceneService, queued: str) -> None:
    changes: list[Operation] = []
    events = client.watch(queued)
    changes.append(next(events))
    _advance(service, queued, [0.25])
    changes.append(next(events))
    service.cancel_operation(queued)
    claim = service._store.jobs.claim(queued)
    assert claim is not None
    service._store.jobs.cancelled(claim)
    changes += events
    assert [operation.state for operation in (changes[0], changes[1], changes[-1])] == [
        "QUEUED",
        "RUNNING",
        "CANCELLED",
    ]
    assert changes[1].stages[0].fraction == 0.25
    assert all(before != after for before, after in itertools.pairwise(changes))
    assert client.operation(queued) == changes[-1]


def test_the_seconds_of_a_running_stage_alone_are_no_event_on_either_protocol(
    service: SceneService, api_settings: Settings, queued: str
) -> None:
    _advance(service, queued, [0.25])
    running = service.get_operation(queued)
    done = replace(running, state="CANCELLED", done=True)

    class Scripted:
        """A service whose operation runs for a while without news; each client sees the script from its beginning."""

        def __init__(self) -> None:
            self.states = [_after(running, seconds) for seconds in (1.0, 2.0, 3.0)] + [done]

        def get_operation(self, operation_id: str) -> Operation:
            return self.states.pop(0) if len(self.states) > 1 else done

    for watch in (
        lambda faces: list(faces.rpc.WatchOperation(pb.WatchOperationRequest(operation_id=queued))),
        lambda faces: list(client_of(faces).watch(queued)),
    ):
        with served(Scripted(), api_settings) as faces:
            assert len(watch(faces)) == 2


def _after(operation: Operation, seconds: float) -> Operation:
    return replace(operation, stages=tuple(replace(stage, seconds=seconds) for stage in operation.stages))


def test_last_event_id_continues_after_what_is_known(faces: Faces, service: SceneService, queued: str) -> None:
    url = f"/v1/operations/{queued}/events"
    with faces.rest.stream("GET", url) as response:
        assert response.headers["content-type"].startswith("text/event-stream")
        first = next(events_of(response.iter_lines()))
    with faces.rest.stream("GET", url, headers={"Last-Event-ID": first.id}) as response:
        events = events_of(response.iter_lines())
        threading.Timer(0.5, lambda: service.cancel_operation(queued)).start()
        second = next(events)  # not the first again
        assert list(events) == []  # it is done
    assert '"CANCELLED"' in second.data and '"CANCELLED"' not in first.data
    with faces.rest.stream("GET", url, headers={"Last-Event-ID": first.id}) as response:
        assert [event.id for event in events_of(response.iter_lines())] == [second.id]
    assert faces.rest.get(url, headers={"Last-Event-ID": second.id}).status_code == 204
    assert rest_refusal(faces.rest.get("/v1/operations/none/events")).reason == "NOT_FOUND"


def test_an_event_stream_is_read_as_the_standard_says() -> None:
    lines = [": hello", "", "id: 1", "data: a", "data:b", "", "event: x", "data: c", "", "data: cut off"]
    assert list(events_of(lines)) == [Event("1", "a\nb"), Event("1", "c", "x")]


def test_events_that_end_before_the_job_does_say_why(
    service: SceneService, api_settings: Settings, queued: str
) -> None:
    class Forgetful:
        """A service whose operation is gone when it is looked for again; each client sees it once."""

        looks = 0

        def get_operation(self, operation_id: str) -> Operation:
            self.looks += 1
            if self.looks % 2:
                return service.get_operation(queued)
            raise NotFoundError("no operation", field="operation_id")

    with served(Forgetful(), api_settings) as faces:
        with faces.rest.stream("GET", f"/v1/operations/{queued}/events") as response:
            first, last = events_of(response.iter_lines())
        assert (first.kind, last.kind) == ("operation", "error")
        assert json.loads(last.data)["reason"] == "NOT_FOUND" and json.loads(last.data)["status"] == 404
        with pytest.raises(NotFoundError, match="no operation"):
            list(client_of(faces).watch(queued))


def test_waiting_ends_with_the_job_or_with_the_time(
    faces: Faces, client: Client, service: SceneService, queued: str
) -> None:
    stands = faces.rpc.WaitOperation(pb.WaitOperationRequest(operation_id=queued, timeout_s=0))
    assert stands == to_proto(service.get_operation(queued)) and not stands.done
    with pytest.raises(DeadlineExceededError):
        client.wait(queued, timeout_s=0.3)
    threading.Timer(0.5, lambda: service.cancel_operation(queued)).start()
    done = client.wait(queued, timeout_s=60)
    assert done.state == "CANCELLED"
    assert faces.rpc.WaitOperation(pb.WaitOperationRequest(operation_id=queued, timeout_s=60)).done
    for timeout_s in (-1.0, 301.0, float("nan")):
        with pytest.raises(grpc.RpcError) as caught:
            faces.rpc.WaitOperation(pb.WaitOperationRequest(operation_id=queued, timeout_s=timeout_s))
        assert rpc_refusal(caught.value).details["field"] == "timeout_s"


def test_operations_are_listed_newest_first(
    faces: Faces, client: Client, service: SceneService, scene_id: str, queued: str
) -> None:
    every = list(client.operations())
    assert {operation.id for operation in every} >= {queued, service.get_scene(scene_id).operation_id}
    assert [job.created_at for job in every] == sorted((job.created_at for job in every), reverse=True)
    first = service.list_operations(1)
    second = service.list_operations(1, first.next_page_token)
    assert [job.id for job in (*first.operations, *second.operations)] == [job.id for job in every[:2]]
    waiting = [operation.id for operation in every if operation.state == "QUEUED"]
    assert [operation.id for operation in client.operations("QUEUED")] == waiting and queued in waiting
    assert faces.rest.get("/v1/operations", params={"state": "LOST"}).status_code == 400
