"""Processes killed for real: whatever was acknowledged is done once, or failed with a reason."""

from __future__ import annotations

import json
import os
import signal
import sys
from contextlib import closing
from pathlib import Path

import pytest

from fastsplat.cli.operating.serve import worker_roles
from fastsplat.service.splatting.training_settings import TrainingSettings
from tests.postgres import PostgresServer
from tests.workers.deployment import STAGES, Deployment, kill, on_both_databases


@on_both_databases()
def test_worker_killed_in_mid_stage_another_that_lives_finishes_the_job_once(deployment: Deployment) -> None:
    operation = deployment.post("capture:child", "training:sleep_once 600")
    first = deployment.start_worker()
    trainer = deployment.wait_in("training", operation)
    grandchild = int((deployment.settings.data_dir / "grandchild.txt").read_text())
    deployment.start_worker()
    deployment.wait_for(lambda: len(deployment.service._store.workers.list_workers()) == 2)
    assert deployment.is_alive(grandchild)

    kill(first)

    deployment.wait_for(lambda: not deployment.is_alive(trainer) and not deployment.is_alive(grandchild))
    assert deployment.wait_over(operation).state == "SUCCEEDED"
    assert [len(deployment.visits(stage)) for stage in STAGES] == [1, 1, 2, 1]
    # The second trainer went on from the first one's checkpoint.
    assert deployment.service.get_scene(operation.scene_id).quality["steps"] == 2


@on_both_databases()
def test_after_a_reboot_everything_acknowledged_runs_once(
    deployment: Deployment, request: pytest.FixtureRequest
) -> None:
    api, worker = deployment.start_api(), deployment.start_worker()
    ids = [deployment.post_over_http("training:sleep_once 600")]
    running = deployment.service.get_operation(ids[0])
    trainer = deployment.wait_in("training", running)
    ids += [deployment.post_over_http(request_id=f"job{number}") for number in range(2)]
    before = deployment.service.get_operation(ids[1])

    kill(api, worker)  # right after the acknowledgement
    deployment.wait_for(lambda: not deployment.is_alive(trainer))
    if deployment.settings.database_url:
        server: PostgresServer = request.getfixturevalue("postgres")
        server.crash()
        server.start()
    assert deployment.service.get_operation(ids[1]).state == before.state == "QUEUED"
    deployment.start_worker()

    operations = [deployment.service.get_operation(operation_id) for operation_id in ids]
    assert [deployment.wait_over(operation).state for operation in operations] == ["SUCCEEDED"] * 3
    assert [len(deployment.visits(stage, running)) for stage in STAGES] == [1, 1, 2, 1]
    for operation in operations[1:]:
        assert [len(deployment.visits(stage, operation)) for stage in STAGES] == [1, 1, 1, 1]
    deployment.wait_for(lambda: deployment.left_over() == [])


_SERVE = """
import sys
from fastsplat.cli.operating.logs import log_to_stderr
import fastsplat.cli.operating.serve
from fastsplat.cli.operating.serve import Role, serve
fastsplat.cli.operating.serve._AFTER_CRASH_S = 0.1
log_to_stderr("serve")
sys.exit(serve({"worker": Role([sys.executable, "-c", sys.argv[1]])}))
"""


def test_a_job_that_kills_its_worker_fails_at_the_limit_of_starts_others_go_on_and_a_retry_finds_its_upload(
    deployment: Deployment,
) -> None:
    deployment.max_starts = 2
    orders = {"": "training:kill_worker", "once": "training:kill_worker_until 2"}
    poison = [deployment.post(order, request_id=request_id) for request_id, order in orders.items()]
    good = deployment.post()
    serve = deployment.start_command([sys.executable, "-c", _SERVE, deployment.worker_code()])

    for operation in poison:
        over = deployment.wait_over(operation)
        assert over.state == "FAILED" and over.error is not None
        assert (over.error.reason, over.error.stage) == ("WORKER_CRASHED", "training")
        assert "2 starts" in over.error.details["limit"] and over.error.details["hint"]
        assert len(deployment.visits("training", operation)) == 2 and len(deployment.visits("capture", operation)) == 1
    assert deployment.wait_over(good).state == "SUCCEEDED"
    again = deployment.service.retry_operation(poison[1].id)
    assert (again.state, again.error, again.stages) == ("QUEUED", None, ())
    assert deployment.wait_over(again).state == "SUCCEEDED"
    assert deployment.service.get_scene(again.scene_id).state == "READY"
    assert deployment.post(orders["once"], request_id="once").id == again.id
    assert serve.poll() is None
    serve.terminate()
    assert serve.wait(timeout=60) == 0
    assert deployment.left_over() == deployment.uploads_of(poison[0])


@pytest.mark.parametrize("kill_order", ["kill_worker_in", "kill_in"])
def test_a_job_that_completes_a_stage_between_crashes_is_not_given_up(deployment: Deployment, kill_order: str) -> None:
    deployment.max_starts = 2
    orders = ("capture", "1"), ("perception", "2"), ("training", "3"), ("export", "4")
    operation = deployment.post(*(f"{stage}:{kill_order} {attempt}" for stage, attempt in orders))
    deployment.start_command([sys.executable, "-c", _SERVE, deployment.worker_code()])
    assert deployment.wait_over(operation).state == "SUCCEEDED"
    assert [len(deployment.visits(stage, operation)) for stage in STAGES] == [2, 2, 2, 2]


def test_workers_of_two_devices_work_at_once_and_their_trainers_see_that_device_and_no_secret(
    deployment: Deployment, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("AWS_SECRET_ACCESS_KEY", "RAY_AUTH_TOKEN"):
        monkeypatch.setenv(name, "secret")
    operations = [deployment.post("capture:environment", "training:sleep 600") for _ in range(2)]
    for role in worker_roles("0,7", 1, 0).values():
        deployment.start_command([sys.executable, "-c", deployment.worker_code()], **role.environment)
    for operation in operations:
        deployment.wait_in("training", operation)
    notes = [json.loads((deployment.settings.data_dir / f"{job.id}.json").read_text()) for job in operations]
    assert {note["CUDA_VISIBLE_DEVICES"] for note in notes} == {"0", "7"}
    assert {note["OMP_NUM_THREADS"] for note in notes} == {str(max(1, len(os.sched_getaffinity(0)) // 2))}
    assert not any(note["secrets"] for note in notes)
    assert {note["niceness"] for note in notes} == {min(19, os.getpriority(os.PRIO_PROCESS, 0) + 1)}


def test_a_job_that_trains_on_a_gpu_waits_for_a_worker_that_has_one(tmp_path: Path) -> None:
    with closing(Deployment(tmp_path, "", training=TrainingSettings(backend="cuda"))) as deployment:
        store = deployment.service._store
        deployment.start_worker()
        deployment.start_worker(FASTSPLAT_TRAINING__BACKEND="cuda", CUDA_VISIBLE_DEVICES="")
        deployment.wait_for(lambda: len(store.workers.list_workers()) == 2)
        operation = deployment.post("training:sleep 600")
        worker = deployment.start_worker(FASTSPLAT_TRAINING__BACKEND="cuda", CUDA_VISIBLE_DEVICES="0")
        deployment.wait_in("training", operation)
        (owner,) = store.jobs.owners()
        assert f"-{worker.pid}-" in owner


@on_both_databases()
def test_a_worker_that_is_told_to_stop_gives_its_job_back_and_another_goes_on(deployment: Deployment) -> None:
    deployment.max_starts = 1
    operation = deployment.post("training:sleep_once 600")
    worker = deployment.start_worker()
    trainer = deployment.wait_in("training", operation)
    worker.terminate()
    assert worker.wait(timeout=60) == 0
    assert not deployment.is_alive(trainer) and deployment.state(operation) == "RUNNING"
    deployment.start_worker()
    over = deployment.wait_over(operation)
    assert (over.state, over.again_after) == ("SUCCEEDED", "worker_stopped")
    assert len(deployment.visits("capture")) == 1


_SUSPEND_INSIDE = """
import os, signal, threading, time
import fastsplat.service.store.queue.job_repository as jobs
report = jobs.JobRepository.report
def suspend(self, claim, stages, **more):
    if not os.path.exists({flag!r}) and any(stage["stage"] == {stage!r} and {finished} for stage in stages):
        with self._writing() as connection:
            connection.execute(jobs.fenced(claim).values(updated_at=time.time()))
            open({flag!r}, "w").close()
            os.kill(os.getpid(), signal.SIGSTOP)
    return report(self, claim, stages, **more)
jobs.JobRepository.report = suspend
"""


@on_both_databases()
def test_a_worker_suspended_inside_a_transaction_is_killed_by_the_next_and_nobody_waits_for_its_locks(
    deployment: Deployment,
) -> None:
    flag = deployment.settings.data_dir / "suspended.txt"
    operation = deployment.post("training:sleep_once 600")
    suspended = deployment.start_worker(code=_SUSPEND_INSIDE.format(flag=str(flag), stage="training", finished=True))
    trainer = deployment.wait_in("training", operation)
    deployment.wait_for(flag.exists)
    deployment.start_worker()

    assert suspended.wait(timeout=60) == -9
    assert deployment.wait_over(operation).state == "SUCCEEDED"
    assert not deployment.is_alive(trainer)
    assert len(deployment.visits("training")) == 2 and len(deployment.visits("export")) == 1


def test_a_worker_of_another_machine_suspended_inside_a_transaction_loses_its_locks_and_its_trainer(
    postgres: PostgresServer, tmp_path: Path
) -> None:
    with postgres.database() as url, closing(Deployment(tmp_path, url)) as deployment:
        flag = deployment.settings.data_dir / "suspended.txt"
        operation = deployment.post("training:sleep_once 600", "export:sleep 2")
        # At the end of a stage, where the next one begins on waking.
        inside = _SUSPEND_INSIDE.format(flag=str(flag), stage="perception", finished='stage["message"] == "done"')
        short = "from fastsplat.service.store.rows import database\ndatabase.IDLE_TRANSACTION_TIMEOUT_S = 3.0\n"
        suspended = deployment.start_worker(elsewhere=True, code=short + inside)
        trainer = deployment.wait_in("training", operation)
        deployment.wait_for(flag.exists)
        deployment.start_worker()
        deployment.wait_in("export", operation)
        suspended.send_signal(signal.SIGCONT)

        assert suspended.wait(timeout=60) == 75
        assert not deployment.is_alive(trainer)
        assert deployment.wait_over(operation).state == "SUCCEEDED"


@on_both_databases()
def test_what_is_known_of_ended_jobs_is_forgotten_in_time_but_for_those_with_a_scene(deployment: Deployment) -> None:
    ready, gone, failed = deployment.post(), deployment.post(), deployment.post("capture:fail")
    often = "import fastsplat.workers.engine.worker as engine\nengine._CLEANUP_INTERVAL_S = 0.5\n"
    first = deployment.start_worker(code=often)
    for operation in (ready, gone, failed):
        deployment.wait_over(operation)
    log = deployment.service._store.blobs.log(failed.id)
    assert log.exists()
    deployment.service.delete_scene(gone.scene_id)
    kill(first)
    deployment.start_worker(code=often, FASTSPLAT_JOBS__ENDED_JOB_RETENTION_S="0.001")

    deployment.wait_for(lambda: not log.exists())
    listed = deployment.service._store.scenes.list_operations
    deployment.wait_for(lambda: {record.id for record in listed(9)} == {ready.id, failed.id})
    assert deployment.service.get_scene(ready.scene_id).state == "READY"
