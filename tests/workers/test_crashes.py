"""Processes killed for real: whatever was acknowledged is done once, or failed with a reason."""

from __future__ import annotations

import json
import os
import sys
from contextlib import closing
from pathlib import Path

import pytest

from fastsplat.cli.devices import worker_roles
from fastsplat.service.common.progress import STAGES
from tests.postgres import PostgresServer
from tests.workers.house import House, kill


def test_worker_killed_in_mid_stage_another_that_lives_finishes_the_job_once(house: House) -> None:
    operation = house.post("capture:child", "training:sleep_once 600")
    first = house.start_worker()
    trainer = house.wait_in("training", operation)
    grandchild = int((house.settings.data_dir / "grandchild.txt").read_text())
    house.start_worker()
    house.wait_for(lambda: len(house.service._store.jobs.workers()) == 2)
    assert house.is_alive(grandchild)

    kill(first)

    house.wait_for(lambda: not house.is_alive(trainer) and not house.is_alive(grandchild))
    assert house.wait_over(operation).state == "SUCCEEDED"
    assert [len(house.visits(stage)) for stage in STAGES] == [1, 1, 2, 1]
    # The second trainer went on from the first one's checkpoint.
    assert house.service.get_scene(operation.scene_id).quality["steps"] == 2


def test_after_a_reboot_everything_acknowledged_runs_once(
    house: House, database_url: str, request: pytest.FixtureRequest
) -> None:
    api, worker = house.start_api(), house.start_worker()
    ids = [house.post_over_http("training:sleep_once 600")]
    running = house.service.get_operation(ids[0])
    trainer = house.wait_in("training", running)
    ids += [house.post_over_http(request_id=f"job{number}") for number in range(2)]
    before = house.service.get_operation(ids[1])

    kill(api, worker)  # right after the acknowledgement
    house.wait_for(lambda: not house.is_alive(trainer))
    if database_url:
        server: PostgresServer = request.getfixturevalue("postgres")
        server.crash()
        server.start()
    assert house.service.get_operation(ids[1]).state == before.state == "QUEUED"
    house.start_worker()

    operations = [house.service.get_operation(operation_id) for operation_id in ids]
    assert [house.wait_over(operation).state for operation in operations] == ["SUCCEEDED"] * 3
    assert [len(house.visits(stage, running)) for stage in STAGES] == [1, 1, 2, 1]
    for operation in operations[1:]:
        assert [len(house.visits(stage, operation)) for stage in STAGES] == [1, 1, 1, 1]
    house.wait_for(lambda: house.left_over() == [])


_SERVE = """
import sys
from fastsplat.cli.logs import log_to_stderr
from fastsplat.cli.serve import Role, serve
log_to_stderr("serve")
sys.exit(serve({"worker": Role([sys.executable, "-c", sys.argv[1]])}))
"""


def test_a_job_that_kills_its_worker_is_parked_after_three_starts_and_the_others_go_on(house: House) -> None:
    poison = [house.post("training:kill_worker") for _ in range(2)]
    good = house.post()
    serve = house.start_command([sys.executable, "-c", _SERVE, house.worker_code()])

    for operation in poison:
        over = house.wait_over(operation)
        assert over.state == "FAILED" and over.error is not None
        assert (over.error.reason, over.error.stage) == ("WORKER_CRASHED", "training")
        assert "3" in over.error.details["limit"] and over.error.details["hint"]
        assert len(house.visits("training", operation)) == 3 and len(house.visits("capture", operation)) == 1
    assert house.wait_over(good).state == "SUCCEEDED"
    assert serve.poll() is None
    serve.terminate()
    assert serve.wait(timeout=60) == 0
    house.wait_for(lambda: house.left_over() == [])


def test_workers_of_two_devices_work_at_once_and_their_trainers_see_that_device_and_no_secret(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    operations = [house.post("capture:environment", "training:sleep 600") for _ in range(2)]
    for role in worker_roles("0,7", 1, 0).values():
        house.start_command([sys.executable, "-c", house.worker_code()], **role.environment)
    for operation in operations:
        house.wait_in("training", operation)
    notes = [json.loads((house.settings.data_dir / f"{each.id}.json").read_text()) for each in operations]
    assert {note["CUDA_VISIBLE_DEVICES"] for note in notes} == {"0", "7"}
    assert {note["OMP_NUM_THREADS"] for note in notes} == {str(max(1, len(os.sched_getaffinity(0)) // 2))}
    assert {note["FASTSPLAT_DATABASE_URL"] for note in notes} == {note["AWS_SECRET_ACCESS_KEY"] for note in notes}
    assert notes[0]["AWS_SECRET_ACCESS_KEY"] is None


def test_a_worker_that_is_told_to_stop_gives_its_job_back_without_blame(house: House) -> None:
    house.max_starts = 1
    operation = house.post("training:sleep_once 600")
    worker = house.start_worker()
    trainer = house.wait_in("training", operation)
    worker.terminate()
    assert worker.wait(timeout=60) == 0
    assert not house.is_alive(trainer) and house.state(operation) == "RUNNING"
    house.start_worker()
    assert house.wait_over(operation).state == "SUCCEEDED"
    assert len(house.visits("capture")) == 1


def test_a_frozen_worker_of_another_machine_that_wakes_is_fenced(house: House) -> None:
    operation = house.post("training:sleep_once 600", "export:sleep 2")
    frozen = house.start_worker(elsewhere=True)
    trainer = house.wait_in("training", operation)
    house.freeze(frozen)
    house.start_worker()
    house.wait_in("export", operation)
    house.wake(frozen)

    assert frozen.wait(timeout=60) == 75
    assert not house.is_alive(trainer)
    assert house.wait_over(operation).state == "SUCCEEDED"
    assert len(house.visits("training")) == 2 and len(house.visits("export")) == 1


_FREEZE_INSIDE = """
import os, signal, threading, time
import fastsplat.service.store.jobs as jobs
report = jobs.JobRows.report
def freeze(self, claim, stages):
    if not os.path.exists({flag!r}) and any(stage["stage"] == {stage!r} and {finished} for stage in stages):
        with self._engine.begin() as connection:
            connection.execute(self._fenced(claim).values(updated_at=time.time()))
            open({flag!r}, "w").close()
            os.kill(os.getpid(), signal.SIGSTOP)
    return report(self, claim, stages)
jobs.JobRows.report = freeze
"""


def test_a_worker_frozen_inside_a_transaction_is_killed_by_the_next_and_nobody_waits_for_its_locks(
    house: House,
) -> None:
    flag = house.settings.data_dir / "frozen.txt"
    operation = house.post("training:sleep_once 600")
    frozen = house.start_worker(code=_FREEZE_INSIDE.format(flag=str(flag), stage="training", finished=True))
    trainer = house.wait_in("training", operation)
    house.wait_for(flag.exists)
    house.start_worker()

    assert frozen.wait(timeout=60) == -9
    assert house.wait_over(operation).state == "SUCCEEDED"
    assert not house.is_alive(trainer)
    assert len(house.visits("training")) == 2 and len(house.visits("export")) == 1


def test_a_worker_of_another_machine_frozen_inside_a_transaction_loses_its_locks_and_its_trainer(
    postgres: PostgresServer, tmp_path: Path
) -> None:
    with postgres.database() as url, closing(House(tmp_path, url)) as house:
        flag = house.settings.data_dir / "frozen.txt"
        operation = house.post("training:sleep_once 600", "export:sleep 2")
        # At the end of a stage: what the job engine records on waking is not its own any more.
        inside = _FREEZE_INSIDE.format(flag=str(flag), stage="perception", finished='stage["message"] == "done"')
        short = "import fastsplat.service.store.engine\nfastsplat.service.store.engine.IDLE_TRANSACTION_S = 3.0\n"
        frozen = house.start_worker(elsewhere=True, code=short + inside)
        trainer = house.wait_in("training", operation)
        house.wait_for(flag.exists)
        house.start_worker()
        house.wait_in("export", operation)
        house.wake(frozen)

        assert frozen.wait(timeout=60) == 75
        assert not house.is_alive(trainer)
        assert house.wait_over(operation).state == "SUCCEEDED"


def test_what_is_known_of_ended_jobs_is_forgotten_in_time_but_for_those_with_a_scene(house: House) -> None:
    kept, gone, failed = house.post(), house.post(), house.post("capture:fail")
    first = house.start_worker()
    for operation in (kept, gone, failed):
        house.wait_over(operation)
    log = house.service._store.blobs.log(failed.id)
    assert log.exists()
    house.service.delete_scene(gone.scene_id)
    kill(first)
    house.start_worker(FASTSPLAT_JOBS__KEEP_ENDED_S="0.001")

    house.wait_for(lambda: not log.exists())
    house.wait_for(lambda: not house.service._store.rows.operations(9, None, "CANCELLED"))
    house.wait_for(lambda: house.engine_records() == 0)
    assert {record.id for record in house.service._store.rows.operations(9)} == {kept.id, failed.id}
    assert house.service.get_scene(kept.scene_id).state == "READY"


def test_two_workers_never_run_one_job(house: House) -> None:
    operations = [house.post("training:sleep 0.3") for _ in range(4)]
    for _ in range(2):
        house.start_worker()
    assert [house.wait_over(operation).state for operation in operations] == ["SUCCEEDED"] * 4
    assert all(len(house.visits(stage)) == 4 for stage in STAGES)
    house.wait_for(lambda: house.left_over() == [])
