"""Damaged results of earlier stages are made again, or end a job with an error that names the file."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import pytest

from fastsplat.service.settings import Settings
from fastsplat.workers.job.protocol import Job
from fastsplat.workers.job.results import discard_damaged, finish_stage, stage_seconds, start_stage
from fastsplat.workers.kinds.create_scene import load_trained, stored_plan
from fastsplat.workers.kinds.job_kinds import KINDS
from fastsplat_contract.errors import ArtefactError
from fastsplat_contract.jobs.operations import SceneOptions


@pytest.fixture
def job(tmp_path: Path) -> Job:
    for stage in ("capture", "training"):
        (tmp_path / stage).mkdir()
    return Job("operation", 1, tmp_path / "upload", tmp_path, SceneOptions(), Settings(data_dir=tmp_path))


@pytest.mark.parametrize("content", [b'{"seconds"0: 1}', b"\xff", b"[]", b"{}", b'{"seconds": null}', b""])
def test_damaged_times_are_named(job: Job, content: bytes) -> None:
    (job.folder / "capture" / "stage.json").write_bytes(content)
    with pytest.raises(ArtefactError, match=r"capture/stage\.json") as caught:
        stage_seconds(job, "capture")
    assert str(job.folder) not in caught.value.message


@pytest.mark.parametrize("content", [b'{"settings"', b"\xff", b"[]", b"{}", b'{"settings": 3}', b""])
def test_a_damaged_plan_is_named(job: Job, content: bytes) -> None:
    (job.folder / "plan.json").write_bytes(content)
    with pytest.raises(ArtefactError, match=r"plan\.json"):
        stored_plan(job)


@pytest.mark.parametrize("content", [b"no archive", b"PK\x03\x04" + bytes(30)])
def test_damaged_arrays_are_named(job: Job, content: bytes) -> None:
    (job.folder / "training" / "arrays.npz").write_bytes(content)
    with pytest.raises(ArtefactError, match=r"training/arrays\.npz"):
        load_trained(job.folder / "training")


def finished(job: Job, *stages: str) -> Job:
    for stage in stages:
        folder = start_stage(job, stage)
        (folder / "views").mkdir()
        (folder / "views" / "1.bin").write_bytes(stage.encode() * 1_000)
        finish_stage(job, stage, folder, 1.0)
    return job


@pytest.fixture
def fresh(tmp_path: Path) -> Job:
    folder = tmp_path / "job"
    folder.mkdir()
    settings, stages = Settings(data_dir=tmp_path), KINDS["create_scene"].stages
    return Job("operation", 1, tmp_path / "upload", folder, SceneOptions(), settings, stages)


def flip(file: Path) -> None:
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)


@pytest.mark.parametrize("damage", ["flipped", "missing", "times"])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_result_that_is_not_as_it_was_written_is_made_again_and_all_after_it(
    fresh: Job, place: int, damage: str
) -> None:
    stages = ("capture", "perception", "training")
    job = finished(fresh, *stages)
    assert discard_damaged(job) == () and all(job.result(stage).is_dir() for stage in stages)
    file = job.result(stages[place]) / ("stage.json" if damage == "times" else "views/1.bin")
    file.unlink() if damage == "missing" else flip(file)
    later = replace(job, attempt=2)
    assert discard_damaged(later) == stages[place:]
    assert [stage for stage in stages if job.result(stage).is_dir()] == list(stages[:place])
    finished(later, *stages[place:])
    assert discard_damaged(later) == ()
    assert {path.name for path in job.folder.iterdir()} == set(stages)


def test_results_of_before_there_were_digests_count_as_whole(fresh: Job) -> None:
    job = finished(fresh, "capture")
    (job.result("capture") / "files.sha256").unlink()
    flip(job.result("capture") / "views" / "1.bin")
    assert discard_damaged(job) == ()


def test_kinds_of_job_pass_between_processes() -> None:
    assert pickle.loads(pickle.dumps(KINDS)) == KINDS
