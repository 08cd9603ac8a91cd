"""Photos to a scene in a folder, by the real stages and a real worker, without a server."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import fastsplat
from fastsplat.service.application.service import open_service
from fastsplat.service.library.local_scene import folder_settings
from fastsplat_contract.codec.json_codec import from_json
from fastsplat_contract.errors import ConflictError, FastSplatError, InvalidInputError, NotFoundError
from fastsplat_contract.jobs.operations import Operation
from tests.processes import processes_with
from tests.small_tabletop import small_tabletop
from tests.trained_scenes import trained_tabletop
from tests.waiting import wait_for

_TRAINING = '{"iterations": 150, "time_budget_s": null, "max_side": 120}'


@pytest.fixture
def capture(test_data: Path, models_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("FASTSPLAT_TRAINING", _TRAINING)
    monkeypatch.setenv("FASTSPLAT_MODELS", str(models_dir))
    return small_tabletop(test_data, tmp_path / "table top", 8)


def _workers(folder: Path) -> list[str]:
    return processes_with("FASTSPLAT_DATA_DIR", folder)


def test_photos_become_a_scene_that_answers_and_can_be_opened_again(
    capture: Path, test_data: Path, models_dir: Path, tmp_path: Path
) -> None:
    folder = trained_tabletop(test_data, models_dir)
    operations = [from_json(Operation, line) for line in (folder / "progress.jsonl").read_bytes().splitlines()]
    assert [stage.stage for stage in operations[-1].stages] == ["capture", "perception", "training", "export"]
    assert operations[-1].state == "SUCCEEDED" and len(operations) > 4
    out = tmp_path / "out"
    shutil.copytree(folder / "scene", out)
    with fastsplat.open_scene(out) as scene:
        assert scene.info.name == "table top" and 0 < scene.info.gaussians <= 6000
        mug = scene.ask("mug")
        assert mug.outcome == "here" and scene.mask("mug", scene.views[0]).any()
    with fastsplat.open_scene(out) as again:
        assert again.id == scene.id and again.ask("mug") == mug
    with pytest.raises(ConflictError, match="has a trained scene"):
        fastsplat.train(capture, out)
    with fastsplat.open_scene(out) as same_scene:
        assert same_scene.id == scene.id


def test_what_is_interrupted_is_over_and_its_folder_is_used_again(capture: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"

    def interrupt(operation: Operation) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fastsplat.train(capture, out, progress=interrupt)
    wait_for(lambda: not _workers(out))  # a trainer that had just begun sees that its worker has ended
    with open_service(folder_settings(out)) as service:
        (scene,) = service.list_scenes().scenes
        assert scene.state != "READY"
        upload = tmp_path / "not a photo"
    upload.mkdir()
    (upload / "photo.jpg").write_text("this is a text")
    with pytest.raises(InvalidInputError):  # the photos are refused, and the scene of before is gone
        fastsplat.train(upload, out)
    with open_service(folder_settings(out)) as service:
        assert service.list_scenes().scenes == ()


def test_the_worker_ends_with_a_script_that_is_killed(capture: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    show = "lambda one: print(one.state, flush=True)"
    script = f"import fastsplat; fastsplat.train({str(capture)!r}, {str(out)!r}, progress={show})"
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, env=os.environ) as process:
        assert process.stdout is not None and process.stdout.readline()
        assert len(_workers(out)) >= 1
        process.kill()
    wait_for(lambda: not _workers(out))


def test_there_must_be_photos(tmp_path: Path) -> None:
    with pytest.raises(NotFoundError, match="there is no"):
        fastsplat.train(tmp_path / "nowhere", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    (tmp_path / "empty").mkdir()
    with pytest.raises(FastSplatError):
        fastsplat.train(tmp_path / "empty", tmp_path / "out")
