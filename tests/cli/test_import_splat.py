"""`fastsplat import-splat`: a splat is checked and queued as any upload is, or refused and nothing is left."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner, Result

from fastsplat.cli.main import app
from fastsplat.service.capture.uploads.splat_input import load_splat
from fastsplat.service.scene.ply import write_ply
from fastsplat.service.settings import load_settings
from fastsplat.service.store.store import open_store
from fastsplat_contract.errors import FastSplatError, InvalidInputError, LimitExceededError, NotFoundError
from tests.capture.test_splat_uploads import some_gaussians


@pytest.fixture
def call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Result]]:
    monkeypatch.setenv("FASTSPLAT_DATA_DIR", str(tmp_path / "data"))

    def run(*words: object) -> Result:
        load_settings.cache_clear()
        return CliRunner().invoke(app, ["import-splat", *map(str, words)])

    yield run
    load_settings.cache_clear()


@pytest.fixture
def splat(tmp_path: Path) -> Path:
    write_ply(some_gaussians(), tmp_path / "desk.ply")
    return tmp_path / "desk.ply"


def _uploads(data: Path) -> list[Path]:
    return list((data / "uploads").iterdir()) if (data / "uploads").exists() else []


def test_a_splat_is_queued_with_what_was_said_of_it(call, splat: Path, tmp_path: Path) -> None:
    result = call(splat, "--up", "-y", "--labels", "cup, teddy bear")
    assert result.exit_code == 0, result.output
    store = open_store(tmp_path / "data")
    (record,) = store.scenes.list_operations(5, None, None)
    assert record.id in result.output and record.scene_id in result.output
    assert (record.options["up"], record.options["labels"]) == ("-y", ["cup", "teddy bear"])
    folder = store.blobs.upload(record.upload_id)
    store.close()
    (arrays,) = folder.rglob("splat.safetensors")
    np.testing.assert_array_equal(load_splat(arrays).means, some_gaussians().means)


def test_a_splat_among_its_photos_is_sent_once(call, splat: Path, tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    photos.mkdir()
    (photos / "desk.ply").hardlink_to(splat)
    Image.new("RGB", (64, 48), (90, 120, 30)).save(photos / "a.png")
    camera = {"fl_x": 60.0, "fl_y": 60.0, "cx": 32.0, "cy": 24.0, "w": 64, "h": 48}
    frames = [{"file_path": "a.png", "transform_matrix": np.eye(4).tolist()}]
    (photos / "transforms.json").write_text(json.dumps({**camera, "frames": frames}))
    result = call(splat, "--photos", photos)
    assert result.exit_code == 0, result.output
    (photos / "desk.ply").unlink()
    (photos / "desk.ply").write_bytes(b"another")
    assert isinstance(call(splat, "--photos", photos).exception, InvalidInputError)


@pytest.mark.parametrize(
    ("words", "kind", "field"),
    [
        (["--up", "w"], InvalidInputError, "up"),
        (["--photos", "nowhere"], NotFoundError, "--photos"),
        (["--project", "nobodys"], NotFoundError, "--project"),
        (["--labels", ",".join(f"l{i}" for i in range(2000))], LimitExceededError, "labels"),
    ],
)
def test_what_is_refused_leaves_nothing(
    call, splat: Path, tmp_path: Path, words: list[str], kind: type[FastSplatError], field: str
) -> None:
    error = call(splat, *words).exception
    assert isinstance(error, kind) and error.field == field and _uploads(tmp_path / "data") == []


def test_files_that_are_no_splats_are_refused(call, tmp_path: Path) -> None:
    assert isinstance(call(tmp_path / "none.ply").exception, NotFoundError)
    (tmp_path / "text.ply").write_text("ply, or so they say")
    assert isinstance(call(tmp_path / "text.ply").exception, InvalidInputError)
    assert _uploads(tmp_path / "data") == []
