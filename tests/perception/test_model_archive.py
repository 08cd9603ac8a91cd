"""Models in one file: what comes out is what went in, and an archive cannot bring anything else."""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.perception.model_pull.model_archive import pack, unpack
from fastsplat.service.perception.model_pull.pull import Step, model_state
from fastsplat.service.perception.models.model_manifest import load_manifest
from fastsplat.service.perception.onnx_session import file_sha256
from fastsplat_contract.errors import (
    ChecksumMismatchError,
    FastSplatError,
    InvalidInputError,
    ModelUnavailableError,
    NotFoundError,
    ResourceError,
    UnsafeArchiveError,
)

Members = dict[str, bytes]


@pytest.fixture
def models(tmp_path: Path) -> Path:
    """A model directory with one label table, "words", that passes its trial."""
    folder = tmp_path / "here" / "words"
    folder.mkdir(parents=True)
    embeds = np.array([[1, 0.1], [1, 0.2], [0, 1]], np.float32)
    np.savez(folder / "table.npz", names=np.array(["cup", "mug", "bridge"]), embeds=embeds)
    return folder.parent


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
def archive(models: Path, manifest: Path, tmp_path: Path) -> Path:
    """Of the models that are there."""
    assert pack(models, tmp_path / "models.zip", manifest=manifest) == ["words"]
    return tmp_path / "models.zip"


def test_what_comes_out_is_what_went_in(models: Path, manifest: Path, archive: Path, tmp_path: Path) -> None:
    there, steps = tmp_path / "there", list[Step]()
    assert unpack(archive, there, report=steps.append, manifest=manifest) == ["words"]
    assert (there / "words/table.npz").read_bytes() == (models / "words/table.npz").read_bytes()
    assert model_state(load_manifest(manifest)[0], there) == "ready" and steps[-1].what == "ready"
    assert [path.name for path in there.iterdir()] == ["words"]
    unpack(archive, there, report=steps.append, manifest=manifest)
    assert steps[-1].what == "already there"


def test_the_same_models_are_the_same_list(models: Path, manifest: Path, archive: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(archive) as opened:
        assert opened.namelist() == ["models.json", "words/table.npz"]
        assert json.loads(opened.read("models.json"))["models"]["words"] == {
            "table.npz": file_sha256(models / "words/table.npz")
        }


@pytest.mark.parametrize(("name", "error"), [("more", NotFoundError), ("nonsense", InvalidInputError)])
def test_only_what_is_there_is_packed(
    models: Path, manifest: Path, tmp_path: Path, name: str, error: type[FastSplatError]
) -> None:
    with pytest.raises(error, match=name):
        pack(models, tmp_path / "some.zip", ["words", name], manifest=manifest)
    assert not (tmp_path / "some.zip").exists()


def test_a_damaged_model_is_not_packed(models: Path, manifest: Path, tmp_path: Path) -> None:
    (models / "words/table.npz").write_bytes(b"half a tab")
    file_sha256.cache_clear()
    with pytest.raises(NotFoundError):
        pack(models, tmp_path / "some.zip", manifest=manifest)


def _listing(models: dict[str, dict[str, str]]) -> bytes:
    return json.dumps({"format": 1, "models": models}).encode()


def _escapes(members: Members) -> None:
    members["../evil.npz"] = members["words/table.npz"]
    members["models.json"] = _listing({"..": {"evil.npz": "0" * 64}})


def _brings_another_file(members: Members) -> None:
    digests = json.loads(members["models.json"])["models"]["words"]
    members["words/hook.py"] = b"import os"
    members["models.json"] = _listing({"words": {**digests, "hook.py": "0" * 64}})


def _is_too_large(members: Members) -> None:
    members["words/table.npz"] += b"\0"


def _has_other_bytes(members: Members) -> None:
    """With a list that agrees with them: the manifest's digest counts."""
    changed = bytearray(members["words/table.npz"])
    changed[100] ^= 1
    members["words/table.npz"] = bytes(changed)
    members["models.json"] = _listing({"words": {"table.npz": hashlib.sha256(changed).hexdigest()}})


def _lacks_a_file(members: Members) -> None:
    del members["words/table.npz"]


def _has_no_list(members: Members) -> None:
    del members["models.json"]


def _is_of_a_later_release(members: Members) -> None:
    members["models.json"] = members["models.json"].replace(b'"format": 1', b'"format": 2')


def _is_not_what_it_lists(members: Members) -> None:
    """Of a model whose digest the manifest does not know."""
    members["more/table.npz"] = b"no table"
    members["models.json"] = _listing({"more": {"table.npz": "0" * 64}})


@pytest.mark.parametrize(
    ("spoil", "error"),
    [
        (_escapes, UnsafeArchiveError),
        (_brings_another_file, UnsafeArchiveError),
        (_is_too_large, UnsafeArchiveError),
        (_has_other_bytes, ChecksumMismatchError),
        (_lacks_a_file, UnsafeArchiveError),
        (_has_no_list, InvalidInputError),
        (_is_of_a_later_release, InvalidInputError),
        (_is_not_what_it_lists, ChecksumMismatchError),
    ],
)
def test_a_hostile_archive_is_refused_and_leaves_nothing(
    manifest: Path, archive: Path, tmp_path: Path, spoil: Callable[[Members], None], error: type[FastSplatError]
) -> None:
    with zipfile.ZipFile(archive) as opened:
        members = {name: opened.read(name) for name in opened.namelist()}
    spoil(members)
    spoiled, there = tmp_path / "spoiled.zip", tmp_path / "there"
    with zipfile.ZipFile(spoiled, "w") as out:
        for name, content in members.items():
            out.writestr(name, content)
    with pytest.raises(error) as caught:
        unpack(spoiled, there, report=lambda step: None, manifest=manifest)
    assert type(caught.value) is error and caught.value.field == "archive"
    assert not there.exists() or list(there.iterdir()) == []
    assert not (tmp_path / "evil.npz").exists()


def test_a_model_without_a_known_digest_is_tried_out(models: Path, manifest: Path, tmp_path: Path) -> None:
    (models / "more").mkdir()
    same = np.ones((3, 2), np.float32)
    np.savez(models / "more/table.npz", names=np.array(["cup", "mug", "bridge"]), embeds=same)
    pack(models, tmp_path / "more.zip", ["more"], manifest=manifest)
    with pytest.raises(ModelUnavailableError, match="does not work"):
        unpack(tmp_path / "more.zip", tmp_path / "there", report=lambda step: None, manifest=manifest)
    assert list((tmp_path / "there").iterdir()) == []


@pytest.mark.parametrize("cut", [0, 10, -30])
def test_an_archive_that_is_not_whole_is_said_to_be(manifest: Path, archive: Path, tmp_path: Path, cut: int) -> None:
    archive.write_bytes(archive.read_bytes()[:cut])
    with pytest.raises(InvalidInputError, match=r"not whole|no list") as caught:
        unpack(archive, tmp_path / "there", report=lambda step: None, manifest=manifest)
    assert caught.value.field == "archive"


def test_an_archive_that_is_not_there_is_said_not_to_be(manifest: Path, tmp_path: Path) -> None:
    with pytest.raises(ResourceError, match="No such file"):
        unpack(tmp_path / "none.zip", tmp_path / "there", report=lambda step: None, manifest=manifest)
