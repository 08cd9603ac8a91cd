"""Jobs while they run: the same pictures, cameras and early ends on REST, gRPC, in the client and in process."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from fastsplat.service.application.jobs import estimates
from fastsplat.service.application.service import SceneService
from fastsplat.service.store.queue.claims import Claim
from fastsplat_client import Client, NotReadyError
from fastsplat_contract.codec.proto_codec import from_proto
from fastsplat_contract.errors import NotFoundError
from fastsplat_contract.jobs.operations import Operation
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.served import Faces
from tests.api.training_job import add_training_job, picture, show_training
from tests.scenes import queued_job


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

    queued = queued_job("waits")
    service._store.scenes.create(queued)
    claim = service._store.jobs.claim(queued.operation_id)
    assert claim is not None
    stage = {"stage": "training", "fraction": 0.0, "message": "", "seconds": 0.0, "metrics": {"iteration": 0.0}}
    for rows in ([], [stage], [{**stage, "fraction": 1.0, "metrics": {"iteration": 9.0}}]):
        service._store.jobs.report(claim, rows)
        with pytest.raises(NotReadyError):
            client.finish(queued.operation_id)
        assert not service.get_operation(queued.operation_id).finish_requested
    service._store.jobs.cancelled(claim)
    with pytest.raises(NotReadyError, match="CANCELLED"):
        client.finish(queued.operation_id)
    with pytest.raises(NotFoundError):
        client.finish("nothing")
    service.delete_scene(queued.scene_id)


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

    _age(service, training.operation.id)
    silent = client.operation(training.operation.id)
    assert silent.worker == "silent" and silent.seconds_left is None
    service._store.workers.unregister("somebody")
    assert client.operation(training.operation.id).worker == "none"
    again = service._store.jobs.claim(training.operation.id)
    assert again is not None
    taken_up = client.operation(training.operation.id)
    assert (taken_up.worker, taken_up.attempt) == ("working", 2)
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


def _age(service: SceneService, operation_id: str) -> None:
    """Make a job's last report an hour old."""
    with service._store.engine.begin() as connection:
        connection.exec_driver_sql(
            f"UPDATE operations SET updated_at = {time.time() - 3600} WHERE id = '{operation_id}'"
        )
