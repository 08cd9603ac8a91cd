"""Folders: published whole, named by ids alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from fastsplat.service.store.blobs.blobs import Blobs, remove


def test_published_is_moved_whole(tmp_path: Path) -> None:
    blobs = Blobs(tmp_path)
    source = tmp_path / "work" / "export"
    (source / "artefact").mkdir(parents=True)
    (source / "artefact" / "scene.json").write_text("{}")
    target = blobs.publish(source, "scene", "v1")
    assert target == blobs.version("scene", "v1")
    assert (target / "artefact" / "scene.json").read_text() == "{}" and not source.exists()
    assert blobs.ids("scenes") == ("scene",) and blobs.ids("jobs") == ()


def test_a_version_is_never_replaced(tmp_path: Path) -> None:
    blobs = Blobs(tmp_path)
    for text in ("first", "second"):
        source = tmp_path / text
        source.mkdir()
        (source / "file").write_text(text)
    blobs.publish(tmp_path / "first", "scene", "v1")
    with pytest.raises(FileExistsError):
        blobs.publish(tmp_path / "second", "scene", "v1")
    assert (blobs.version("scene", "v1") / "file").read_text() == "first"


@pytest.mark.parametrize("name", ["", ".", "..", "../x", "a/b", "a\\b", ".hidden", "nul\0"])
def test_only_ids_name_folders(tmp_path: Path, name: str) -> None:
    with pytest.raises(ValueError, match="not an id"):
        Blobs(tmp_path).upload(name)


def test_remove_takes_anything(tmp_path: Path) -> None:
    (tmp_path / "folder" / "deep").mkdir(parents=True)
    outside = tmp_path / "outside"
    outside.mkdir()
    (tmp_path / "link").symlink_to(outside)
    for name in ("folder", "link", "absent"):
        remove(tmp_path / name)
    assert list(tmp_path.iterdir()) == [outside]
