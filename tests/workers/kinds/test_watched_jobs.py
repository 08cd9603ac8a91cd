"""Jobs that are watched and ended early, with real processes that die."""

from __future__ import annotations

import pytest

from fastsplat_contract.errors import NotFoundError, NotReadyError
from fastsplat_contract.jobs.operations import Operation
from tests.workers.deployment import Deployment, kill


def _wait_for_pictures(deployment: Deployment, operation: Operation, number: int) -> Operation:
    """The operation once it has shown so many pictures."""

    def with_pictures() -> Operation:
        return deployment.service.get_operation(operation.id)

    deployment.wait_for(lambda: (preview := with_pictures().preview) is not None and preview.number >= number)
    return with_pictures()


def test_a_job_shows_itself_until_it_is_ended_early_and_is_ready_then(shared_deployment: Deployment) -> None:
    deployment = shared_deployment
    before, operation = deployment.post("perception:sleep 3"), deployment.post("training:until_finish")
    deployment.wait_in("perception", before)
    with pytest.raises(NotReadyError, match="not begun"):
        deployment.service.jobs.finish(before.id)
    assert deployment.service.get_operation(operation.id).worker == "waiting"

    first = _wait_for_pictures(deployment, operation, 1)
    assert first.worker == "working" and first.attempt == 1 and first.seconds_left == 100.0
    later = _wait_for_pictures(deployment, operation, 4)
    assert later.preview is not None and first.preview is not None and later.preview.step > first.preview.step
    assert deployment.service.jobs.preview(operation.id).picture.startswith(b"attempt 1 picture ")
    record = deployment.service._store.scenes.operation(operation.id)
    folder = deployment.service._store.blobs.job(record.run_id) / "progress"
    assert len(list(folder.glob("preview*"))) <= 4  # those that were replaced go

    assert deployment.service.jobs.finish(operation.id).finish_requested
    assert deployment.wait_over(operation).state == "SUCCEEDED"
    scene = deployment.service.get_scene(operation.scene_id)
    assert scene.state == "READY" and scene.quality["stopped_early"]
    assert not deployment.service.get_scene(before.scene_id).quality["stopped_early"]
    for call in (deployment.service.jobs.preview, deployment.service.jobs.placed_cameras):
        with pytest.raises(NotFoundError):
            call(operation.id)
    with pytest.raises(NotReadyError, match="SUCCEEDED"):
        deployment.service.jobs.finish(operation.id)
    deployment.wait_for(lambda: deployment.left_over(operation) == [])


def test_a_cancelled_job_shows_nothing_and_begins_anew_when_it_is_retried(shared_deployment: Deployment) -> None:
    deployment = shared_deployment
    operation = deployment.post("training:until_finish")
    _wait_for_pictures(deployment, operation, 2)
    deployment.service.cancel_operation(operation.id)
    assert deployment.wait_over(operation).preview is None
    deployment.wait_for(lambda: deployment.left_over(operation) == deployment.uploads_of(operation))

    assert deployment.service.retry_operation(operation.id).preview is None
    again = _wait_for_pictures(deployment, operation, 1)
    assert again.preview is not None and not again.finish_requested
    deployment.service.jobs.finish(operation.id)
    assert deployment.wait_over(operation).state == "SUCCEEDED"


def test_an_early_end_outlives_the_worker_and_its_pictures_count_on(deployment: Deployment) -> None:
    operation = deployment.post("training:until_finish")
    first = deployment.start_worker()
    before = _wait_for_pictures(deployment, operation, 2)
    assert before.preview is not None
    trainer = deployment.wait_in("training", operation)
    deployment.suspend(first)  # it can do nothing more for the job, and nobody knows that yet
    deployment.service.jobs.finish(operation.id)
    kill(first)
    deployment.wait_for(lambda: not deployment.is_alive(trainer))
    # Nobody runs, and the job says so as soon as that is known; it can still be looked at.
    deployment.wait_for(lambda: deployment.service.get_operation(operation.id).worker == "none")
    assert deployment.service.jobs.preview(operation.id).picture.startswith(b"attempt 1 ")

    deployment.start_worker()
    over = deployment.wait_over(operation)
    assert over.state == "SUCCEEDED" and over.attempt == 2 and over.finish_requested
    assert deployment.service.get_scene(operation.scene_id).quality["stopped_early"]
    assert len(deployment.visits("training", operation)) == 2
