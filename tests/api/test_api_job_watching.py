"""Jobs while they run: the same pictures, cameras and early ends on REST, gRPC, in the client and in process."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from io import BytesIO

import grpc
import numpy as np
import pytest
from PIL import Image

from fastsplat.service.application.service import SceneService
from fastsplat.service.store.claims import Claim
from fastsplat_client import Client, NotReadyError
from fastsplat_contract.errors import NotFoundError
from fastsplat_contract.operations import Operation
from fastsplat_contract.proto_codec import from_proto
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.served import Faces, rest_refusal, rpc_refusal
from tests.api.training_job import add_training_job, make_old, picture, show_training
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
    other = faces.rest.get(f"/v1/operations/{job}/preview.jpg", headers={"If-None-Match": answer.headers["etag"]})
    assert other.status_code == 200 and other.content == picture(2)

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
        refused = rest_refusal(faces.rest.post(f"/v1/operations/{queued.operation_id}:finish"))
        with pytest.raises(grpc.RpcError) as error:
            faces.rpc.FinishOperation(pb.FinishOperationRequest(operation_id=queued.operation_id))
        assert (refused.code, rpc_refusal(error.value).code) == (409, "FAILED_PRECONDITION")
        assert replace(refused, code=0) == replace(rpc_refusal(error.value), code=0)
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

    make_old(service, training.operation.id)
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
