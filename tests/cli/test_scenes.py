"""`fastsplat scenes`: photos, videos and splats become scenes; what became of photos is listed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import Result

from fastsplat.service.application.service import SceneService
from fastsplat.service.capture.uploads.splat_input import load_splat
from fastsplat.service.scene.formats.ply import write_ply
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.errors import FastSplatError, InvalidInputError, LimitExceededError, NotFoundError
from fastsplat_contract.photos.photo_verdicts import PhotoVerdict
from tests.scene.conftest import make_gaussians
from tests.scenes import claimed_job

Run = Callable[..., Result]


@pytest.fixture
def splat(tmp_path: Path) -> Path:
    write_ply(make_gaussians(40, 4, 0), tmp_path / "desk.ply")
    return tmp_path / "desk.ply"


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    """A photo with its pose."""
    (tmp_path / "photos").mkdir()
    Image.new("RGB", (64, 48), (90, 120, 30)).save(tmp_path / "photos" / "a.png")
    camera = {"fl_x": 60.0, "fl_y": 60.0, "cx": 32.0, "cy": 24.0, "w": 64, "h": 48}
    frames = [{"file_path": "a.png", "transform_matrix": np.eye(4).tolist()}]
    (tmp_path / "photos" / "transforms.json").write_text(json.dumps({**camera, "frames": frames}))
    return tmp_path / "photos"


def _uploads(service: SceneService) -> set[Path]:
    return set(service._store.blobs.upload("x").parent.glob("*"))


def test_a_splat_is_queued_with_what_was_said_of_it(fastsplat: Run, service: SceneService, splat: Path) -> None:
    result = fastsplat("scenes", "create", splat, "--up", "-y", "--labels", "cup, teddy bear")
    assert result.exit_code == 0, result.exception
    (record,) = service._store.scenes.list_operations(1, None, None)
    assert f"job {record.id} of scene {record.scene_id} is QUEUED" in result.stdout
    assert service.get_scene(record.scene_id).name == "desk"
    assert (record.options["up"], record.options["labels"]) == ("-y", ["cup", "teddy bear"])
    (arrays,) = service._store.blobs.upload(record.upload_id).rglob("splat.safetensors")
    np.testing.assert_array_equal(load_splat(arrays).means, make_gaussians(40, 4, 0).means)


def test_a_splat_goes_with_its_photos_once(fastsplat: Run, service: SceneService, splat: Path, photos: Path) -> None:
    for beside in (False, True):
        if beside:
            (photos / "desk.ply").hardlink_to(splat)
        result = fastsplat("scenes", "create", splat, "--photos", photos, "--json")
        assert result.exit_code == 0, result.exception
        upload = service._store.scenes.operation(json.loads(result.stdout)["id"]).upload_id
        names = {path.name for path in service._store.blobs.upload(upload).rglob("*")}
        assert any("splat" in name for name in names) and "a.png" in names, names
    (photos / "desk.ply").unlink()
    (photos / "desk.ply").write_bytes(b"another")
    refused = fastsplat("scenes", "create", splat, "--photos", photos).exception
    assert isinstance(refused, InvalidInputError) and "desk.ply" in refused.message
    assert isinstance(fastsplat("scenes", "create", photos, "--photos", photos).exception, InvalidInputError)


@pytest.mark.parametrize(
    ("words", "kind", "field"),
    [
        (["--up", "w"], InvalidInputError, "up"),
        (["--photos", "nowhere"], InvalidInputError, "--photos"),
        (["--project", "nobodys"], NotFoundError, "x-fastsplat-project"),
        (["--labels", ",".join(f"l{i}" for i in range(2000))], LimitExceededError, "labels"),
    ],
)
def test_what_is_refused_leaves_nothing(
    fastsplat: Run, service: SceneService, splat: Path, words: list[str], kind: type[FastSplatError], field: str
) -> None:
    before = _uploads(service)
    error = fastsplat("scenes", "create", splat, *words).exception
    assert isinstance(error, kind) and error.field == field
    assert _uploads(service) == before


def test_files_that_make_no_scene_are_refused(fastsplat: Run, service: SceneService, tmp_path: Path) -> None:
    before = _uploads(service)
    assert isinstance(fastsplat("scenes", "create", tmp_path / "none.ply").exception, NotFoundError)
    (tmp_path / "text.ply").write_text("ply, or so they say")
    assert isinstance(fastsplat("scenes", "create", tmp_path / "text.ply").exception, InvalidInputError)
    (tmp_path / "empty").mkdir()
    assert isinstance(fastsplat("scenes", "create", tmp_path / "empty").exception, InvalidInputError)
    assert _uploads(service) == before


def test_what_became_of_its_photos_is_listed(fastsplat: Run, service: SceneService) -> None:
    claim = claimed_job(service._store)
    scene_id = claim.operation.scene_id
    unseen = fastsplat("scenes", "photos", scene_id)
    assert unseen.exit_code == 0 and "nobody has looked" in unseen.stderr and not unseen.stdout
    lost = PhotoVerdict("[b]1.jpg", False, "no_overlap", ("blurred",), "", 0.3, 0.8, 0, "Take it again.")
    good = PhotoVerdict("2.jpg", True, None, (), "", 1.0, 0.8, 120, "")
    service._store.jobs.record_photos(claim, [to_plain(lost), to_plain(good)])
    listed = fastsplat("scenes", "photos", scene_id)
    for text in ("[b]1.jpg", "not placed: no overlap, blurred", "Take it again.", "2.jpg"):
        assert text in listed.stdout
    assert "1 of 2 photos have a place" in listed.stderr
    assert json.loads(fastsplat("scenes", "photos", scene_id, "--json").stdout)["photos"][0] == to_plain(lost)
