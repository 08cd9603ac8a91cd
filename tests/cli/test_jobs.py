"""`fastsplat jobs`: jobs are listed with where they stand, watched, ended, retried; a failed one's log is there."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from typing import Any

import pytest
from typer.testing import Result

from fastsplat.service.application.service import SceneService
from fastsplat_contract.errors import InvalidInputError, NotFoundError, NotReadyError
from tests.commands import invoke
from tests.scenes import claimed_job, queued_job

Run = Callable[..., Result]


@pytest.fixture
def waiting(service: SceneService) -> str:
    job = queued_job()
    service._store.scenes.create(job)
    return job.operation_id


@pytest.fixture
def failed(service: SceneService) -> str:
    claim = claimed_job(service._store, replace(queued_job(), options={"validated": ""}))
    error = {"kind": "INTERNAL", "reason": "CRASHED", "message": "it died [/b]", "stage": "training", "details": {}}
    service._store.jobs.fail(claim, error)
    log = service._store.blobs.log(claim.operation.id)
    log.parent.mkdir(exist_ok=True)
    log.write_bytes(b"first\nlast words \xff\n")
    return claim.operation.id


def _listed(fastsplat: Run, *words: str) -> list[dict[str, Any]]:
    jobs: list[dict[str, Any]] = json.loads(fastsplat("jobs", "list", "--json", *words).stdout)["operations"]
    return jobs


def test_jobs_are_listed_with_where_they_stand(fastsplat: Run, failed: str, waiting: str) -> None:
    everything = fastsplat("jobs", "list").stdout
    assert failed[:8] in everything and waiting[:8] in everything and "training: it died [/b]" in everything
    only = fastsplat("jobs", "list", "--state", "failed").stdout
    assert failed[:8] in only and waiting[:8] not in only
    assert fastsplat("jobs", "list", "--state", "lost").exit_code == 2
    newest, before = _listed(fastsplat, "--limit", "2")
    assert (newest["id"], newest["state"], before["id"], before["state"]) == (waiting, "QUEUED", failed, "FAILED")
    assert _listed(fastsplat, "--state", "succeeded") == []
    text = fastsplat("jobs", "show", failed).stdout
    assert "CRASHED" in text and "it died [/b]" in text
    watched = fastsplat("jobs", "watch", failed)
    assert watched.exit_code == 1 and "it died [/b]" in watched.stderr and watched.stdout == ""


def test_a_failed_job_is_queued_again_if_its_upload_is_there(
    fastsplat: Run, service: SceneService, failed: str
) -> None:
    assert isinstance(fastsplat("jobs", "retry", failed).exception, NotFoundError)
    service._store.blobs.upload(service._store.scenes.operation(failed).upload_id).mkdir(parents=True)
    assert isinstance(fastsplat("jobs", "retry", failed, "--exclude", "a.jpg").exception, InvalidInputError)
    assert "QUEUED" in fastsplat("jobs", "retry", failed).stdout
    assert "CANCELLED" in fastsplat("jobs", "cancel", failed[:8]).stdout


def test_a_job_that_trains_is_ended_early_and_no_other(fastsplat: Run, service: SceneService, waiting: str) -> None:
    assert isinstance(fastsplat("jobs", "finish", waiting).exception, NotReadyError)
    claim = service._store.jobs.claim(waiting)
    assert claim is not None
    service._store.workers.update_heartbeat("a worker", "here", 1)
    metrics = {"iteration": 40.0, "job_seconds_left": 70.0}
    row = {"stage": "training", "fraction": 0.2, "message": "iteration 40", "seconds": 1.0, "metrics": metrics}
    service._store.jobs.report(claim, [row])
    assert "about 70 s left in all" in fastsplat("jobs", "show", waiting).stdout
    service._store.scenes.create(behind := replace(queued_job(), priority=9))
    assert "QUEUED, 1 job ahead, begins in about 70 s" in fastsplat("jobs", "show", behind.operation_id).stdout
    service.cancel_operation(behind.operation_id)
    assert waiting in fastsplat("jobs", "finish", waiting).stdout
    assert service._store.jobs.check(claim) == {"finish"}
    assert json.loads(fastsplat("jobs", "show", waiting, "--json").stdout)["finish_requested"]


def test_a_failed_jobs_log_and_error_are_there_and_others_are_not_found(failed: str, waiting: str) -> None:
    result = invoke("jobs", "log", failed)
    assert result.stdout.startswith("first\nlast words") and "CRASHED" in result.stderr
    for name in (waiting, "nothing"):
        assert isinstance(invoke("jobs", "log", name).exception, NotFoundError)


def test_the_version_is_that_of_the_distribution() -> None:
    assert invoke("--version").stdout.split() == ["fastsplat", version("fastsplat")]
