"""Finished stages that workers store for each other: what a job goes on from is of one line of attempts."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from fastsplat.service.common.progress import ProgressEvent
from fastsplat.service.settings import CallSettings
from fastsplat.service.store.artefact_settings import ArtefactSettings
from fastsplat.service.store.rows.records import NewJob
from fastsplat.service.store.store import open_store
from fastsplat.workers.engine.supervisor import _StageRows
from fastsplat.workers.job.claimed_job import ClaimedJob
from tests.workers.deployment import STAGES


@pytest.fixture
def machines(tmp_path: Path) -> Iterator[tuple[ClaimedJob, ClaimedJob]]:
    """One job as two machines see it, which share a database and an object store."""
    url, artefacts = f"sqlite:///{tmp_path}/jobs.sqlite", ArtefactSettings(url=f"file://{tmp_path}/bucket")
    here, there = (open_store(tmp_path / name, url, artefacts) for name in ("here", "there"))
    here.scenes.create(NewJob("scene", "job", "", "", "", "upload", {"labels": [], "validated": ""}))
    claim = here.jobs.claim("job")
    assert claim is not None
    yield ClaimedJob(here, claim, CallSettings()), ClaimedJob(there, claim, CallSettings())
    here.close()
    there.close()


def _finish(job: ClaimedJob, stage: str, attempt: int) -> Path:
    result = job.folder / stage
    result.mkdir(parents=True)
    (result / "stage.json").write_text(json.dumps({"seconds": 1.0, "attempt": attempt}))
    return result


def test_what_an_attempt_left_that_was_cut_off_gives_way_with_all_that_follows_from_it(
    machines: tuple[ClaimedJob, ClaimedJob],
) -> None:
    here, there = machines
    stored = {"capture": 2}
    mine = [_finish(here, stage, 1) for stage in ("capture", "perception", "checkpoint.1")]
    _finish(there, "capture", 2)
    assert there.keep_result("capture") == 2

    here.fetch_results(stored)

    assert [path.is_dir() for path in mine] == [True, False, False]
    assert json.loads((mine[0] / "stage.json").read_text())["attempt"] == 2
    later = _finish(here, "perception", 3)
    here.fetch_results(stored)  # as after a restart on this machine
    assert later.is_dir()


def test_no_result_is_fetched_behind_one_that_cannot_be(machines: tuple[ClaimedJob, ClaimedJob]) -> None:
    here, there = machines
    for stage in STAGES[:3]:
        _finish(there, stage, 1)
        there.keep_result(stage)
    (damaged,) = (there._blobs.root.parent / "bucket/jobs/job/perception.1").rglob("stage.json")
    damaged.write_text("damaged")
    here.fetch_results(dict.fromkeys(STAGES[:3], 1))
    assert [(here.folder / stage).is_dir() for stage in STAGES] == [True, False, False, False]


def test_a_stage_that_is_made_again_and_those_behind_it_are_not_stored_until_they_are_done() -> None:
    rows = _StageRows([], STAGES)
    for stage in STAGES[:3]:
        rows.update(ProgressEvent(stage, 1.0, "finished"))
        rows.note_stored(stage, 1)
    assert rows.stored == dict.fromkeys(STAGES[:3], 1)
    rows.update(ProgressEvent("perception", 0.0, "starting perception"))
    assert rows.stored == {"capture": 1}
