"""Jobs with real processes and one worker that outlives them all: done once, or ended with a reason; nothing left."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import numpy as np
import pytest

from fastsplat.service.scene.artefact.scene_files import read_scene
from fastsplat_contract.errors import NotFoundError
from tests.workers.deployment import STAGES, on_both_databases


@on_both_databases("shared_deployment")
def test_a_job_ends_ready_and_leaves_only_its_scene(shared_deployment):
    deployment = shared_deployment
    operation = deployment.post()

    over = deployment.wait_over(operation)

    assert over.state == "SUCCEEDED" and over.error is None
    assert [stage.stage for stage in over.stages] == list(STAGES)
    assert all(stage.fraction == 1.0 for stage in over.stages)
    assert over.stages[0].metrics == {"attempt": 1.0}
    scene = deployment.service.get_scene(operation.scene_id)
    assert scene.state == "READY" and scene.gaussians == 5 and scene.scale == "METRIC"
    assert [row.label for row in scene.dictionary] == ["mug", "box"]
    assert set(scene.quality["stage_seconds"]) >= {"capture", "export"}
    version = deployment.service._store.blobs.version(scene.id, scene.version)
    assert (version / "scene.ply").read_bytes().startswith(b"ply")
    deployment.wait_for(lambda: deployment.left_over(operation) == [])


def test_a_job_whose_trainer_was_killed_is_begun_again_after_the_next(shared_deployment):
    deployment = shared_deployment
    killed, good = deployment.post("perception:kill_once"), deployment.post()
    over = [deployment.wait_over(operation) for operation in (killed, good)]
    assert [operation.state for operation in over] == ["SUCCEEDED"] * 2 and len(over[1].attempts) == 1
    assert [(attempt.number, attempt.why) for attempt in over[0].attempts] == [(1, "trainer_died"), (2, None)]
    visited = [visit.operation_id for visit in deployment.visits("perception")]
    assert len(deployment.visits("capture", killed)) == 1
    assert visited[-3:] == [killed.id, good.id, killed.id]


def test_a_job_that_always_kills_its_trainer_fails_and_the_next_goes_on(shared_deployment):
    deployment = shared_deployment
    poison, good = deployment.post("training:kill"), deployment.post()

    over = deployment.wait_over(poison)

    assert over.state == "FAILED" and over.error is not None
    assert (over.error.reason, over.error.stage) == ("TRAINER_CRASHED", "training")
    assert "SIGKILL" in over.error.message and over.error.details["hint"] and "3" in over.error.details["limit"]
    assert len(deployment.visits("training", poison)) == 3
    assert deployment.service.get_scene(poison.scene_id).state == "FAILED"
    assert deployment.wait_over(good).state == "SUCCEEDED"
    deployment.wait_for(lambda: deployment.left_over(poison, good) == deployment.uploads_of(poison))


@pytest.mark.parametrize(
    ("order", "reason", "stage"),
    [
        ("perception:fail", "RECONSTRUCTION_FAILED", "perception"),
        ("export:defect", "INTERNAL", "export"),
        ("training:full", "OUT_OF_RESOURCES", "training"),
    ],
)
def test_a_failure_says_what_where_and_what_to_do(shared_deployment, order, reason, stage):
    deployment = shared_deployment
    operation = deployment.post(order)

    over = deployment.wait_over(operation)

    assert over.state == "FAILED" and over.error is not None
    assert (over.error.reason, over.error.stage) == (reason, stage)
    assert over.error.details["hint"]
    assert len(deployment.visits(stage, operation)) == 1  # what would fail again is not tried again
    assert deployment.service.get_scene(operation.scene_id).state == "FAILED"
    deployment.wait_for(lambda: deployment.left_over(operation) == deployment.uploads_of(operation))
    deployment.service.delete_scene(operation.scene_id)
    deployment.wait_for(lambda: deployment.left_over(operation) == [])


def test_cancelled_in_the_queue_never_runs_and_cancelled_while_running_the_trainer_is_gone(shared_deployment):
    deployment = shared_deployment
    running, queued = deployment.post("training:sleep 600"), deployment.post()
    trainer = deployment.wait_in("training", running)

    assert deployment.service.cancel_operation(queued.id).state == "CANCELLED"
    deployment.service.cancel_operation(running.id)

    deployment.wait_for(lambda: not deployment.is_alive(trainer))  # it would sleep for ten minutes
    assert deployment.wait_over(running).state == "CANCELLED"
    assert deployment.wait_over(deployment.post()).state == "SUCCEEDED"
    assert deployment.visits("capture", queued) == []
    for operation in (running, queued):
        assert deployment.state(operation) == "CANCELLED"
        assert deployment.service.get_scene(operation.scene_id).state == "CANCELLED"
    deployment.wait_for(lambda: deployment.left_over(running) == deployment.uploads_of(running))

    assert deployment.service.retry_operation(queued.id).state == "QUEUED"
    assert deployment.wait_over(queued).state == "SUCCEEDED"
    assert deployment.service.retry_operation(running.id).state == "QUEUED"
    deployment.wait_in("training", running, visit=2)
    deployment.service.delete_scene(running.scene_id)
    assert deployment.service.get_scene(queued.scene_id).state == "READY"
    deployment.wait_for(lambda: deployment.left_over(running, queued) == [])


@on_both_databases("shared_deployment")
def test_deleted_while_running_nothing_remains(shared_deployment):
    deployment = shared_deployment
    operation = deployment.post("training:sleep 600", request_id="deleted")
    trainer = deployment.wait_in("training", operation)

    deployment.service.delete_scene(operation.scene_id)

    with pytest.raises(NotFoundError):
        deployment.service.get_scene(operation.scene_id)
    assert deployment.wait_over(operation).state == "CANCELLED"
    assert not deployment.is_alive(trainer)
    deployment.wait_for(lambda: deployment.left_over(operation) == [])
    assert deployment.service._store.blobs.ids("scenes").count(operation.scene_id) == 0
    again = deployment.post(request_id="deleted")
    assert again.id != operation.id and deployment.wait_over(again).state == "SUCCEEDED"


def test_a_scene_deleted_while_it_is_read_is_read_whole_or_not_at_all(shared_deployment):
    deployment = shared_deployment
    operation = deployment.post()
    assert deployment.wait_over(operation).state == "SUCCEEDED"
    blobs, version = deployment.service._store.blobs, deployment.service.get_scene(operation.scene_id).version
    whole = read_scene(blobs.version(operation.scene_id, version) / "artefact")
    started = threading.Barrier(5)

    def read_until_gone() -> int:
        started.wait()
        count = 0
        while (folder := blobs.fetch_version(operation.scene_id, version)) is not None:
            with suppress(NotFoundError):
                scene = read_scene(folder / "artefact")
                assert np.array_equal(scene.gaussians.means, whole.gaussians.means)
            count += 1
        return count

    with ThreadPoolExecutor(4) as pool:
        readers = [pool.submit(read_until_gone) for _ in range(4)]
        started.wait()
        deployment.service.delete_scene(operation.scene_id)
        assert all(reader.result() >= 0 for reader in readers)
    assert whole.gaussians.means.shape == (5, 3) and np.isfinite(np.asarray(whole.gaussians.means)).all()
    with pytest.raises(NotFoundError):
        deployment.service.get_scene(operation.scene_id)
