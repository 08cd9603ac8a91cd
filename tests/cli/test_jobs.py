"""`fastsplat jobs`: jobs are listed with where they stand; a failed one's log is there."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from fastsplat.cli.main import app
from fastsplat.service.settings import load_settings
from fastsplat.service.store.records import NewJob
from fastsplat.service.store.store import open_store
from fastsplat_contract.errors import InvalidInputError, NotFoundError, NotReadyError

NEW, BAD = "0123456789abcdef" * 2, "fedcba9876543210" * 2
IDS = (NEW, "a" * 32, BAD, "b" * 32)
"""Newest job, its scene, oldest job, its scene."""


@pytest.fixture
def fastsplat(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Result]]:
    monkeypatch.setenv("FASTSPLAT_DATA_DIR", str(tmp_path))

    def call(*words: str) -> Result:
        load_settings.cache_clear()
        return CliRunner().invoke(app, words)

    store = open_store(tmp_path)
    for scene_id, job_id in ((IDS[3], IDS[2]), (IDS[1], IDS[0])):
        store.scenes.create(NewJob(scene_id, job_id, "desk", "", "d", job_id, {"admitted": ""}, priority=7))
    claim = store.jobs.claim(BAD)
    assert claim is not None
    error = {
        "kind": "INTERNAL",
        "reason": "TRAINER_CRASHED",
        "message": "it died [/b]",
        "stage": "training",
        "details": {},
    }
    store.jobs.fail(claim, error)
    store.blobs.log(BAD).parent.mkdir()
    store.blobs.log(BAD).write_bytes(b"first\nlast words \xff\n")
    store.close()
    yield call
    load_settings.cache_clear()


def test_jobs_are_listed_with_where_they_stand(fastsplat):
    everything = fastsplat("jobs", "list").stdout
    assert BAD[:8] in everything and IDS[1][:8] in everything and "training: it died [/b]" in everything
    failed = fastsplat("jobs", "list", "--state", "failed").stdout
    assert BAD[:8] in failed and NEW[:8] not in failed
    assert fastsplat("jobs", "list", "--state", "lost").exit_code == 2
    newest, oldest = _listed(fastsplat)
    assert (newest["id"], newest["scene_id"], oldest["id"], oldest["scene_id"]) == IDS
    assert (newest["state"], newest["error"], oldest["state"]) == ("QUEUED", None, "FAILED")
    assert _listed(fastsplat, "--limit", "1") == [newest] and _listed(fastsplat, "--state", "running") == []
    shown = fastsplat("jobs", "show", BAD).stdout
    assert "TRAINER_CRASHED" in shown and "it died [/b]" in shown
    watched = fastsplat("jobs", "watch", BAD)
    assert watched.exit_code == 1 and "it died [/b]" in watched.stderr and watched.stdout == ""


def _listed(fastsplat, *words: str) -> list[dict[str, Any]]:
    jobs: list[dict[str, Any]] = json.loads(fastsplat("jobs", "list", "--json", *words).stdout)["operations"]
    return jobs


def test_a_failed_job_is_queued_again_if_its_upload_is_there(fastsplat, tmp_path):
    assert isinstance(fastsplat("jobs", "retry", BAD).exception, NotFoundError)
    (tmp_path / "uploads" / BAD).mkdir(parents=True)
    assert isinstance(fastsplat("jobs", "retry", BAD, "--exclude", "a.jpg").exception, InvalidInputError)
    assert "QUEUED" in fastsplat("jobs", "retry", BAD).stdout
    assert _listed(fastsplat, "--state", "failed") == []
    assert "CANCELLED" in fastsplat("jobs", "cancel", BAD[:4]).stdout


def test_a_job_that_trains_is_ended_early_and_no_other(fastsplat, tmp_path):
    assert isinstance(fastsplat("jobs", "finish", NEW).exception, NotReadyError)
    store = open_store(tmp_path)
    claim = store.jobs.claim(NEW)
    assert claim is not None
    store.workers.update_heartbeat("a worker", "here", 1)
    metrics = {"iteration": 40.0, "job_seconds_left": 70.0}
    row = {"stage": "training", "fraction": 0.2, "message": "iteration 40", "seconds": 1.0, "metrics": metrics}
    store.jobs.report(claim, [row])
    assert "about 70 s left in all" in fastsplat("jobs", "show", NEW).stdout
    assert NEW in fastsplat("jobs", "finish", NEW).stdout
    assert store.jobs.check(claim) == {"finish"}
    assert _listed(fastsplat)[0]["finish_requested"]
    store.close()


def test_the_version_is_that_of_the_distribution(fastsplat):
    assert fastsplat("--version").stdout.split() == ["fastsplat", version("fastsplat")]


def test_a_failed_jobs_log_and_error_are_there_and_others_are_not_found(fastsplat):
    result = fastsplat("jobs", "log", BAD)
    assert result.stdout.startswith("first\nlast words") and "TRAINER_CRASHED" in result.stderr
    for name in (NEW, "nothing"):
        assert isinstance(fastsplat("jobs", "log", name).exception, NotFoundError)
