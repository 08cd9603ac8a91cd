"""The data folder of each release, as it wrote it: this one opens them, loses nothing, and goes on."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import pytest

from fastsplat_contract.messages.scenes import Edit
from tests.api.made_scene import ENCODER, write_words
from tests.commands import invoke
from tests.store.released_folder import MOST_BYTES, RELEASED, make, opened, told_by

_ARCHIVES = sorted(RELEASED.glob("*.zip"))


@pytest.fixture(params=[*(path.name for path in _ARCHIVES), "the next release's"])
def unpacked(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, dict[str, Any]]:
    """A data folder as a release left it, and what that told of it; the next release's is made now."""
    archive = RELEASED / request.param
    if not archive.is_file():
        make(archive := tmp_path / "next.zip")
    with zipfile.ZipFile(archive) as file:
        file.extractall(tmp_path / "unpacked")
    write_words(tmp_path / "models")
    return tmp_path / "unpacked" / "data", json.loads((tmp_path / "unpacked" / "told.json").read_text())


def test_everything_is_there_nothing_is_wrong_and_it_goes_on(
    unpacked: tuple[Path, dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, record = unpacked
    with opened(folder, tmp_path / "models") as service:
        assert json.loads(json.dumps(told_by(service))) == record
        first = service.admin.keys.valid().find((folder / "key").read_text().strip())
        assert first is not None and first.role == "operator"
        scene = record["scenes"]["edited"]
        redone = service.versions.redo(scene["id"])  # by what an earlier release recorded
        assert [version.version for version in service.versions.all(scene["id"])] == scene["versions"]
        assert redone.version == scene["versions"][-1]
        named = service.versions.edit(scene["id"], [Edit("name", object_ids=(1,), name="cup")])
        assert service.versions.all(scene["id"])[-1].version == named.version
        assert service.get_scene(scene["id"]).gaussians < scene["gaussians"]  # the removal that was undone there
    monkeypatch.setenv("FASTSPLAT_DATA_DIR", str(folder))
    monkeypatch.setenv("FASTSPLAT_MODELS", str(tmp_path / "models"))
    monkeypatch.setenv("FASTSPLAT_PERCEPTION__TEXT_ENCODER", ENCODER)
    examined = invoke("doctor", "--repair", "--json")  # an archive keeps no permissions
    assert (examined.exit_code, json.loads(examined.stdout)) == (0, []), examined.stdout


def test_a_folder_is_small_and_is_written_once(tmp_path: Path) -> None:
    assert all(path.stat().st_size <= MOST_BYTES for path in _ARCHIVES)
    (tmp_path / "made.zip").touch()
    with pytest.raises(FileExistsError):
        make(tmp_path / "made.zip")
