"""Operations by list, wait and events, and jobs while they run: alike on both faces, in the client and in process."""

from __future__ import annotations

import itertools
import json
import threading
from collections.abc import Iterator
from dataclasses import replace
from io import BytesIO

import grpc
import numpy as np
import pytest
from PIL import Image

from fastsplat.service.application.jobs import estimates
from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import Settings
from fastsplat.service.store.queue.claims import Claim
from fastsplat_client import Client, DeadlineExceededError, NotReadyError
from fastsplat_client.transport import Event, events_of
from fastsplat_contract.codec.proto_codec import from_proto, to_proto
from fastsplat_contract.errors import NotFoundError
from fastsplat_contract.jobs.operations import Operation
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.clients import client_of
from tests.api.served import Faces, rest_refusal, rpc_refusal, served
from tests.api.training_job import add_training_job, make_old, picture, show_training
from tests.scenes import claimed_job, queued_job


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


@pytest.fixture
def training(service: SceneService) -> Iterator[Claim]:
    """A job that trains; whoever runs it is not heard from again."""
    claim = add_training_job(service)
    yield claim
    service.delete_scene(claim.operation.scene_id)


def test_the_newest_picture_and_the_placed_cameras_are_shown(
    faces: Faces, service: SceneService, client: Client, training: Claim
) -> None:
    job = training.operation.id
    truth = service.jobs.preview(job)
    assert truth.picture == picture(1) and truth.info == service.get_operation(job).preview
    answer = faces.rest.get(f"/v1/operations/{job}/preview.jpg")
    assert answer.content == truth.picture and answer.headers["x-fastsplat-step"] == "300"
    assert Image.open(BytesIO(answer.content)).size == (truth.info.width, truth.info.height)
    same = faces.rest.get(f"/v1/operations/{job}/preview.jpg", headers={"If-None-Match": answer.headers["etag"]})
    assert same.status_code == 304 and not same.content
    show_training(service, training, 2)
    response = faces.rest.get(f"/v1/operations/{job}/preview.jpg", headers={"If-None-Match": answer.headers["etag"]})
    assert response.status_code == 200 and response.content == picture(2)

    placed = service.jobs.placed_cameras(job)
    assert placed.info == service.get_operation(job).placed and placed.info.placed == len(placed.cameras) == 2
    read = client.placed_cameras(job)
    assert read.points.shape == read.colors.shape == (200, 3) and read.points.tobytes() == placed.points
    assert np.array_equal(read.cameras[1].world_from_camera, placed.cameras[1].world_from_camera)


def test_an_early_end_is_asked_for_once_and_refused_outside_the_training(
    faces: Faces, service: SceneService, client: Client, training: Claim
) -> None:
    job = training.operation.id
    first = faces.rest.post(f"/v1/operations/{job}:finish").json()
    assert first["finish_requested"] and first["state"] == "RUNNING"
    again = from_proto(Operation, faces.rpc.FinishOperation(pb.FinishOperationRequest(operation_id=job)))
    assert again == client.finish(job) == service.jobs.finish(job) == service.get_operation(job)
    assert service._store.jobs.check(training) == {"finish"}

    claim = claimed_job(service._store)
    waits = claim.operation.id
    stage = {"stage": "training", "fraction": 0.0, "message": "", "seconds": 0.0, "metrics": {"iteration": 0.0}}
    for rows in ([], [stage], [{**stage, "fraction": 1.0, "metrics": {"iteration": 9.0}}]):
        service._store.jobs.report(claim, rows)
        with pytest.raises(NotReadyError):
            client.finish(waits)
        assert not service.get_operation(waits).finish_requested
    service._store.jobs.cancelled(claim)
    with pytest.raises(NotReadyError, match="CANCELLED"):
        client.finish(waits)
    with pytest.raises(NotFoundError):
        client.finish("nothing")
    service.delete_scene(claim.operation.scene_id)


def test_a_job_that_is_done_shows_nothing_more(service: SceneService, client: Client) -> None:
    claim = add_training_job(service)
    job = claim.operation.id
    service._store.blobs.drop_progress_file(claim.operation.run_id, "preview-1-1.jpg")
    with pytest.raises(NotFoundError):  # its machine is gone, e.g.
        client.preview(job)
    service._store.jobs.cancelled(claim)
    operation = client.operation(job)
    assert operation.preview is None and operation.placed is None and operation.seconds_left is None
    service.delete_scene(claim.operation.scene_id)


def test_who_works_on_a_job(service: SceneService, client: Client, training: Claim) -> None:
    queued = queued_job("waits")
    service._store.scenes.create(queued)
    assert client.operation(queued.operation_id).worker == "none"
    service._store.workers.update_heartbeat("somebody", "a machine", 1)
    assert client.operation(queued.operation_id).worker == "waiting"
    running = client.operation(training.operation.id)
    assert (running.worker, running.attempt, running.seconds_left) == ("working", 1, 199.0)
    assert "job_seconds_left" not in running.stages[-1].metrics

    make_old(service, training.operation.id)
    silent = client.operation(training.operation.id)
    assert silent.worker == "silent" and silent.seconds_left is None
    service._store.workers.unregister("somebody")
    assert client.operation(training.operation.id).worker == "none"
    again = service._store.jobs.claim(training.operation.id)
    assert again is not None
    taken_up = client.operation(training.operation.id)
    assert (taken_up.worker, taken_up.attempt) == ("working", 2)
    assert [(run.number, run.worker, run.why) for run in taken_up.attempts] == [(1, "", "worker_died"), (2, "", None)]
    service._store.workers.update_heartbeat("somebody", "a machine", 1)
    service._store.jobs.release(again, 60.0)
    assert client.operation(training.operation.id).worker == "waiting"
    service._store.workers.unregister("somebody")
    service._store.jobs.cancelled(again)
    assert client.operation(training.operation.id).worker is None
    service.delete_scene(queued.scene_id)


def test_a_job_that_waits_says_how_many_are_ahead_and_for_how_long(
    faces: Faces, service: SceneService, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(estimates, "_FRESH_S", 0.0)
    store, jobs = service._store, [queued_job(f"number {number}") for number in range(4)]
    jobs[1] = replace(jobs[1], options={**jobs[1].options, "predicted_s": 300.0})
    for job in jobs:
        store.scenes.create(job)
    trains = store.jobs.claim(jobs[0].operation_id, "one")
    assert trains is not None
    show_training(service, trains, 1)

    def said() -> list[tuple[int | None, float | None]]:
        queue = [service.get_operation(job.operation_id) for job in jobs[1:]]
        assert queue == [client.operation(job.id) for job in queue]
        ask = faces.rpc.GetOperation
        assert queue == [from_proto(Operation, ask(pb.GetOperationRequest(operation_id=job.id))) for job in queue]
        listed = {job.id: job for job in service.list_operations().operations}
        assert queue == [listed[job.id] for job in queue]
        return [(job.jobs_ahead, job.starts_in_s) for job in queue]

    store.workers.update_heartbeat("one", "a machine", 1)
    assert said() == [(1, 200.0), (2, 500.0), (3, None)]  # how long the second takes, nobody knows
    store.workers.update_heartbeat("two", "a machine", 2)
    assert said() == [(1, 0.0), (2, 200.0), (3, 300.0)]
    store.jobs.release(trains)  # begun, it stays the first
    assert said() == [(1, 0.0), (2, 200.0), (3, 300.0)]
    store.jobs.cancelled(trains)
    assert said() == [(0, 0.0), (1, 0.0), (2, 300.0)]
    assert store.jobs.claim(jobs[1].operation_id, "one") is not None
    assert said() == [(None, None), (1, 0.0), (2, None)]
    for executor in ("one", "two"):
        store.workers.unregister(executor)
    assert said()[1] == (1, None)
    for job in jobs:
        service.delete_scene(job.scene_id)
    assert service.get_operation(jobs[2].operation_id).jobs_ahead is None
