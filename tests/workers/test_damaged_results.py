"""Results of earlier stages that were damaged on the disk end a job with an error that names the file."""

from __future__ import annotations

from pathlib import Path

import pytest

from fastsplat.service.settings import Settings
from fastsplat.workers.budget import stored_plan
from fastsplat.workers.protocol import Job
from fastsplat.workers.results import stage_seconds
from fastsplat.workers.stages import load_trained
from fastsplat_contract.errors import ArtefactError
from fastsplat_contract.operations import SceneOptions


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
