"""The sample scene that comes with the product."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

import fastsplat
from fastsplat.service.library.sample import sample_folder
from fastsplat.service.settings import load_settings
from fastsplat.service.store.care import sample_scene
from fastsplat.service.store.care.sample_scene import SAMPLE_ARCHIVE, unpack_sample
from fastsplat.service.store.store import open_store
from fastsplat_contract.errors import ConflictError, InvalidInputError, ResourceError
from tests.commands import invoke

_MOST_BYTES = 3_000_000


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where temporary files go."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_it_is_a_small_and_whole_data_folder(temporary: Path) -> None:
    assert SAMPLE_ARCHIVE.stat().st_size <= _MOST_BYTES
    with sample_folder() as folder:
        store = open_store(folder)
        (scene_id,) = store.scenes.ready_scene_ids()
        version = store.blobs.version(scene_id, store.scenes.scene(scene_id).version)
        store.blobs.check_version(version)  # every byte, the PLY that was written again among them
        assert len(list((version / "photos").glob("*.jpg"))) == 26
        store.close()
    assert list(temporary.iterdir()) == []


def test_it_says_nothing_of_where_it_was_made(temporary: Path) -> None:
    # Where a machine keeps people's files, passing files and this checkout: nothing under their topmost folders.
    folders = (Path.home(), temporary, Path(__file__).resolve())
    beginnings = {f"/{folder.parts[1]}/".encode() for folder in folders}
    with sample_folder() as folder:
        contents = {path: path.read_bytes() for path in folder.rglob("*") if path.suffix in (".sqlite", ".json")}
    assert contents
    assert {path.name: word for path, content in contents.items() for word in beginnings if word in content} == {}


def test_it_is_asked_and_gone_when_it_is_closed(models_dir: Path, temporary: Path) -> None:
    with fastsplat.open_sample() as scene:
        answer = scene.ask("cup")
        assert answer.outcome == "here" and len(answer.object_ids) == 1
        assert scene.info.scale == "METRIC"
        kinds = {obj.name: obj.surface for obj in scene.objects()}
        assert kinds["dining table"] == "horizontal surface" and "floor" not in kinds.values()
        scene.name(answer.object_ids[0], "beaker of tea")
        assert scene.ask("beaker of tea").object_ids == answer.object_ids
    assert list(temporary.iterdir()) == []
    with fastsplat.open_sample() as again:
        assert "beaker of tea" not in {obj.name for obj in again.objects()}


def test_it_is_asked_from_any_folder_with_the_models_of_the_user(
    models_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "home" / "fastsplat").mkdir(parents=True)
    (tmp_path / "home" / "fastsplat" / "models").symlink_to(models_dir.resolve())
    monkeypatch.chdir(tmp_path / "empty")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    monkeypatch.delenv("FASTSPLAT_MODELS")
    load_settings.cache_clear()
    try:
        with fastsplat.open_sample() as scene:
            assert scene.ask("cup").outcome == "here"
    finally:
        load_settings.cache_clear()
    assert list((tmp_path / "empty").iterdir()) == []


def test_a_folder_in_use_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(ConflictError, match="not empty"):
        unpack_sample(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_a_missing_archive_and_a_damaged_one_are_said(
    temporary: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sample_scene, "SAMPLE_ARCHIVE", tmp_path / "none.zip")
    with pytest.raises(ResourceError, match="not installed"):
        unpack_sample(tmp_path / "data")
    content = bytearray(SAMPLE_ARCHIVE.read_bytes())
    content[len(content) // 2] ^= 0xFF
    (tmp_path / "damaged.zip").write_bytes(content)
    monkeypatch.setattr(sample_scene, "SAMPLE_ARCHIVE", tmp_path / "damaged.zip")
    with pytest.raises(InvalidInputError, match="damaged"):
        unpack_sample(tmp_path / "data")
    assert not (tmp_path / "data").exists()


def test_the_word_sample_stands_for_it_where_no_folder_has_that_name(
    models_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    said = invoke("ask", "sample", "banana").stdout
    assert "banana, at (" in said and ") m" in said
    command = [sys.executable, "-m", "fastsplat.cli.main", "ask", "sample", "banana"]
    (tmp_path / "sample").mkdir()
    refused = subprocess.run(command, capture_output=True, text=True)
    assert refused.returncode == 2 and "no scene has the id 'sample'" in refused.stderr
