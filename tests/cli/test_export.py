"""`fastsplat export`: files by their ending, here and from a server."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from fastsplat.cli.main import app
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import load_settings
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.exports import ExportRequest
from tests.api.made_scene import ENCODER, add_scene, write_words


@pytest.fixture
def service(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SceneService]:
    write_words(tmp_path / "models")
    monkeypatch.setenv("FASTSPLAT_DATA_DIR", str(tmp_path / "data"))
    monkeypatch.setenv("FASTSPLAT_MODELS", str(tmp_path / "models"))
    monkeypatch.setenv("FASTSPLAT_PERCEPTION__TEXT_ENCODER", ENCODER)
    load_settings.cache_clear()
    with open_service(load_settings()) as service:
        yield service
    load_settings.cache_clear()


def test_a_scene_is_written_as_its_ending_says(service: SceneService, tmp_path: Path) -> None:
    scene_id = add_scene(service, load_settings())
    for name, more, request in (
        ("a.spz", [], ExportRequest(scene_id, "spz")),
        ("a.PLY", [], ExportRequest(scene_id, "ply")),
        ("b.ply", ["--thing", "2"], ExportRequest(scene_id, "ply", things=(2,))),
        ("c.bin", ["--format", "spz"], ExportRequest(scene_id, "spz")),
        ("d.points.ply", ["--cell", "0.2"], ExportRequest(scene_id, "points", cell=0.2)),
        ("D.glb", [], ExportRequest(scene_id, "glb")),
    ):
        result = CliRunner().invoke(app, ["export", scene_id, str(tmp_path / name), *more])
        assert result.exit_code == 0, result.output
        assert (tmp_path / name).read_bytes() == service.exports.file(request)


def test_a_file_of_no_format_is_refused(service: SceneService, tmp_path: Path) -> None:
    scene_id = add_scene(service, load_settings())
    result = CliRunner().invoke(app, ["export", scene_id, str(tmp_path / "a.obj")])
    assert isinstance(result.exception, InvalidInputError) and not list(tmp_path.glob("a.*"))
