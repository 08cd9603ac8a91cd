"""Jobs with real processes, killed for real: done once, or failed with a reason; nothing left behind."""

from __future__ import annotations

import os
import signal

import pytest

from service.common.errors import NotFoundError
from service.common.progress import STAGES


def test_a_job_ends_ready_and_leaves_only_its_scene(house):
    operation = house.post()
    house.start_worker()

    over = house.wait_over(operation)

    assert over.state == "SUCCEEDED" and over.error is None
    assert [stage.stage for stage in over.stages] == list(STAGES)
    assert all(stage.fraction == 1.0 for stage in over.stages)
    assert over.stages[0].metrics == {"attempt": 1.0}
    scene = house.service.get_scene(operation.scene_id)
    assert scene.state == "READY" and scene.gaussians == 5 and scene.scale == "METRIC"
    assert [row.label for row in scene.dictionary] == ["mug", "box"]
    assert set(scene.quality["stage_seconds"]) >= {"capture", "export"}
    assert house.service.scene_ply(scene.id)[0].read_bytes().startswith(b"ply")
    house.wait_for(lambda: house.left_over() == [])


def test_worker_killed_in_mid_stage_another_finishes_the_job_once(house):
    operation = house.post("training:sleep_once 60")
    first = house.start_worker()
    trainer = house.wait_in("training")
    os.kill(first.pid, signal.SIGKILL)
    house.wait_for(lambda: not house.is_alive(trainer))

    house.start_worker()
    over = house.wait_over(operation)

    assert over.state == "SUCCEEDED"
    assert len(house.visits("capture")) == 1 and len(house.visits("perception")) == 1
    assert len(house.visits("training")) == 2 and len(house.visits("export")) == 1
    # The second trainer went on from the first one's checkpoint.
    assert house.service.get_scene(operation.scene_id).quality["steps"] == 2


def test_grandchildren_die_with_the_worker(house):
    house.post("capture:child", "training:sleep 60")
    worker = house.start_worker()
    house.wait_in("training")
    grandchild = int((house.settings.data_dir / "grandchild.txt").read_text())
    assert house.is_alive(grandchild)
    os.kill(worker.pid, signal.SIGKILL)
    house.wait_for(lambda: not house.is_alive(grandchild))


def test_trainer_killed_once_is_started_again(house):
    operation = house.post("perception:kill_once")
    house.start_worker()
    assert house.wait_over(operation).state == "SUCCEEDED"
    assert len(house.visits("capture")) == 1 and len(house.visits("perception")) == 2


def test_a_job_that_always_kills_its_trainer_is_parked_and_the_next_goes_on(house):
    poison, good = house.post("training:kill"), house.post()
    house.start_worker()

    over = house.wait_over(poison)

    assert over.state == "FAILED" and over.error is not None
    assert (over.error.reason, over.error.stage) == ("TRAINER_CRASHED", "training")
    assert "SIGKILL" in over.error.message and over.error.details["hint"] and "3" in over.error.details["limit"]
    assert len(house.visits("training")) >= 3
    assert house.service.get_scene(poison.scene_id).state == "FAILED"
    assert house.wait_over(good).state == "SUCCEEDED"
    house.wait_for(lambda: house.left_over() == [])


def test_a_job_whose_worker_dies_three_times_is_parked(house):
    operation = house.post("capture:sleep 60")
    for visit in (1, 2, 3):
        worker = house.start_worker()
        house.wait_in("capture", visit)
        os.kill(worker.pid, signal.SIGKILL)
    house.start_worker()

    over = house.wait_over(operation)

    assert over.state == "FAILED" and over.error is not None
    assert (over.error.reason, over.error.stage) == ("WORKER_CRASHED", "capture")
    assert len(house.visits("capture")) == 3


@pytest.mark.parametrize(
    ("order", "reason", "stage"),
    [("perception:fail", "RECONSTRUCTION_FAILED", "perception"), ("export:defect", "INTERNAL", "export")],
)
def test_a_failure_says_what_where_and_what_to_do(house, order, reason, stage):
    operation = house.post(order)
    house.start_worker()

    over = house.wait_over(operation)

    assert over.state == "FAILED" and over.error is not None
    assert (over.error.reason, over.error.stage) == (reason, stage)
    assert over.error.details["hint"]
    assert len(house.visits(stage)) == 1  # what would fail again is not tried again
    house.wait_for(lambda: house.left_over() == [])


def test_cancelled_in_the_queue_never_runs(house):
    operation = house.post()
    assert house.service.cancel_operation(operation.id).state == "CANCELLED"
    assert house.left_over() == []
    other = house.post()
    house.start_worker()
    assert house.wait_over(other).state == "SUCCEEDED"
    assert len(house.visits("capture")) == 1
    assert house.state(operation) == "CANCELLED"


def test_cancelled_while_running_the_trainer_is_gone(house):
    operation = house.post("training:sleep 60")
    house.start_worker()
    trainer = house.wait_in("training")

    house.service.cancel_operation(operation.id)

    assert house.wait_over(operation).state == "CANCELLED"
    assert not house.is_alive(trainer)
    assert house.service.get_scene(operation.scene_id).state == "FAILED"
    house.wait_for(lambda: house.left_over() == [])


def test_deleted_while_running_nothing_remains(house):
    operation = house.post("training:sleep 60", request_id="once")
    house.start_worker()
    trainer = house.wait_in("training")

    house.service.delete_scene(operation.scene_id)

    with pytest.raises(NotFoundError):
        house.service.get_scene(operation.scene_id)
    assert house.wait_over(operation).state == "CANCELLED"
    assert not house.is_alive(trainer)
    house.wait_for(lambda: house.left_over() == [])
    assert house.post("training:sleep 60", request_id="once").id != operation.id


def test_a_worker_that_is_told_to_stop_gives_its_job_back_without_blame(house):
    house.max_starts = 1
    operation = house.post("training:sleep 2")
    for visit in (1, 2):
        worker = house.start_worker()
        trainer = house.wait_in("training", visit)
        worker.terminate()
        assert worker.wait(timeout=30) == 0
        assert not house.is_alive(trainer) and house.state(operation) == "RUNNING"
    house.start_worker()
    assert house.wait_over(operation).state == "SUCCEEDED"
    assert len(house.visits("capture")) == 1


def test_a_frozen_worker_that_wakes_is_fenced(house):
    operation = house.post("training:sleep_once 60", "export:sleep 2")
    frozen = house.start_worker()
    trainer = house.wait_in("training")
    house.freeze(frozen)
    house.start_worker()
    house.wait_in("export")
    os.kill(frozen.pid, signal.SIGCONT)

    assert frozen.wait(timeout=30) == 75
    assert not house.is_alive(trainer)
    assert house.wait_over(operation).state == "SUCCEEDED"
    assert len(house.visits("training")) == 2 and len(house.visits("export")) == 1


def test_two_workers_never_run_one_job(house):
    operations = [house.post("training:sleep 0.3") for _ in range(4)]
    for _ in range(2):
        house.start_worker()
    assert [house.wait_over(operation).state for operation in operations] == ["SUCCEEDED"] * 4
    assert all(len(house.visits(stage)) == 4 for stage in STAGES)
