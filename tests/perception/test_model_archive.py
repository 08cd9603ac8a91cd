"""Models in one file: what comes out is what went in, and an archive cannot bring anything else."""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.perception.model_pull.model_archive import unpack
from fastsplat.service.perception.model_pull.pull import Step, model_state
from fastsplat.service.perception.models.model_manifest import load_manifest
from fastsplat.service.perception.onnx_session import file_sha256
from fastsplat_contract.errors import (
    ChecksumMismatchError,
    FastSplatError,
    InvalidInputError,
    ModelUnavailableError,
    UnsafeArchiveError,
)

Members = dict[str, bytes]


@pytest.fixture
def models(table: Path, tmp_path: Path) -> Path:
    """A model directory with one label table, "words"."""
    (tmp_path / "here" / "words").mkdir(parents=True)
    table.rename(tmp_path / "here" / "words" / "table.npz")
    return tmp_path / "here"


@pytest.fixture
def manifest(models: Path, tmp_path: Path) -> Path:
    """Two label tables: of "words" size and sha256 are known, of "more", which is not there, neither."""
    table = models / "words" / "table.npz"
    head = 'role = "text_encoder"\nadapter = "label_table"\nlicense = "MIT"\nabout = "A few words."'
    known = f'name = "table.npz"\nsize = {table.stat().st_size}\nsha256 = "{file_sha256(table)}"'
    (tmp_path / "manifest.toml").write_text(
        f'[[model]]\nname = "words"\n{head}\n[[model.files]]\n{known}\n'
        f'[[model]]\nname = "more"\n{head}\n[[model.files]]\nname = "table.npz"\n'
    )
    return tmp_path / "manifest.toml"


@pytest.fixture
def archive(models: Path, tmp_path: Path) -> Path:
    return _zipped(models, tmp_path / "models.zip")


def _zipped(models: Path, archive: Path) -> Path:
    """As any program zips a folder, with entries of the folders."""
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as out:
        for path in sorted(models.rglob("*")):
            out.write(path, path.relative_to(models))
    return archive


def test_what_comes_out_is_what_went_in(models: Path, manifest: Path, archive: Path, tmp_path: Path) -> None:
    there, steps = tmp_path / "there", list[Step]()
    assert unpack(archive, there, report=steps.append, manifest=manifest) == ["words"]
    assert (there / "words/table.npz").read_bytes() == (models / "words/table.npz").read_bytes()
    assert model_state(load_manifest(manifest)[0], there) == "ready" and steps[-1].what == "ready"
    assert [path.name for path in there.iterdir()] == ["words"]
    unpack(archive, there, report=steps.append, manifest=manifest)
    assert steps[-1].what == "already there"
    again = _zipped(there, tmp_path / "again.zip")  # with the receipt, as people zip what was pulled
    assert unpack(again, tmp_path / "third", report=steps.append, manifest=manifest) == ["words"]
    assert (tmp_path / "third/words/pulled.json").read_bytes() == (there / "words/pulled.json").read_bytes()


_TABLE = "words/table.npz"
_SPOILED: dict[str, tuple[type[FastSplatError], Callable[[bytes], Members]]] = {
    "escapes": (UnsafeArchiveError, lambda table: {_TABLE: table, "../evil.npz": table}),
    "brings another file": (UnsafeArchiveError, lambda table: {_TABLE: table, "words/hook.py": b"import os"}),
    "is too large": (UnsafeArchiveError, lambda table: {_TABLE: table + b"\0"}),
    "has other bytes": (ChecksumMismatchError, lambda table: {_TABLE: table[:-1] + bytes([table[-1] ^ 1])}),
    "lacks a file": (InvalidInputError, lambda table: {"words/": b""}),
    "has an unknown model": (UnsafeArchiveError, lambda table: {_TABLE: table, "nonsense/table.npz": b"no table"}),
}


@pytest.mark.parametrize("spoiled", _SPOILED)
def test_a_hostile_archive_is_refused_and_leaves_nothing(
    models: Path, manifest: Path, tmp_path: Path, spoiled: str
) -> None:
    (error, members), there = _SPOILED[spoiled], tmp_path / "there"
    with zipfile.ZipFile(tmp_path / "spoiled.zip", "w") as out:
        for name, content in members((models / _TABLE).read_bytes()).items():
            out.writestr(name, content)
    with pytest.raises(error) as caught:
        unpack(tmp_path / "spoiled.zip", there, report=lambda step: None, manifest=manifest)
    assert type(caught.value) is error and caught.value.field == "archive"
    assert not there.exists() or list(there.iterdir()) == []
    assert not (tmp_path / "evil.npz").exists()


def test_a_model_without_a_known_digest_is_tried_out(models: Path, manifest: Path, tmp_path: Path) -> None:
    (models / "more").mkdir()
    same = np.ones((3, 2), np.float32)
    np.savez(models / "more/table.npz", names=np.array(["cup", "mug", "bridge"]), embeds=same)
    shutil.rmtree(models / "words")
    with pytest.raises(ModelUnavailableError, match="does not work"):
        unpack(_zipped(models, tmp_path / "more.zip"), tmp_path / "there", report=lambda step: None, manifest=manifest)
    assert list((tmp_path / "there").iterdir()) == []


@pytest.mark.parametrize("cut", [0, 10, -30])
def test_an_archive_that_is_not_whole_is_said_to_be(manifest: Path, archive: Path, tmp_path: Path, cut: int) -> None:
    archive.write_bytes(archive.read_bytes()[:cut])
    with pytest.raises(InvalidInputError, match="not whole") as caught:
        unpack(archive, tmp_path / "there", report=lambda step: None, manifest=manifest)
    assert caught.value.field == "archive"


def test_an_archive_that_is_not_there_is_said_not_to_be(manifest: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match=r"there is no file .*none\.zip"):
        unpack(tmp_path / "none.zip", tmp_path / "there", report=lambda step: None, manifest=manifest)
