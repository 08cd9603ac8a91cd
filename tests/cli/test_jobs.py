"""`fastsplat jobs`: jobs are listed with where they stand; a failed one's log is there."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from fastsplat.cli.main import app
from fastsplat.service.settings import load_settings
from fastsplat.service.store import open_store
from fastsplat.service.store.records import NewJob
from fastsplat_contract.errors import InvalidInputError, NotFoundError


@pytest.fixture
def fastsplat(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Result]]:
    monkeypatch.setenv("FASTSPLAT_DATA_DIR", str(tmp_path))
    monkeypatch.setenv("COLUMNS", "240")

    def call(*words: str) -> Result:
        load_settings.cache_clear()
        return CliRunner().invoke(app, words)

    store = open_store(tmp_path)
    for name in ("bad", "new"):
        store.rows.admit(NewJob(f"{name}scene", f"{name}job", "desk", "", "d", name, {}, priority=7))
    claim = store.jobs.claim("badjob")
    assert claim is not None
    error = {"kind": "INTERNAL", "reason": "TRAINER_CRASHED", "message": "it died", "stage": "training", "details": {}}
    store.jobs.fail(claim, error)
    store.blobs.log("badjob").parent.mkdir()
    store.blobs.log("badjob").write_bytes(b"first\nlast words \xff\n")
    store.close()
    yield call
    load_settings.cache_clear()


def test_jobs_are_listed_with_where_they_stand(fastsplat):
    everything = fastsplat("jobs", "list").stdout
    assert "badjob" in everything and "newscene" in everything and "training: it died" in everything
    failed = fastsplat("jobs", "list", "--state", "failed").stdout
    assert "badjob" in failed and "newjob" not in failed
    assert isinstance(fastsplat("jobs", "list", "--state", "lost").exception, InvalidInputError)


def test_a_failed_jobs_log_and_error_are_there_and_others_are_not_found(fastsplat):
    result = fastsplat("jobs", "log", "badjob")
    assert result.stdout.startswith("first\nlast words") and "TRAINER_CRASHED" in result.stderr
    for name in ("newjob", "nothing"):
        assert isinstance(fastsplat("jobs", "log", name).exception, NotFoundError)
