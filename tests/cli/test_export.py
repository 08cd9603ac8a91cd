"""`fastsplat scenes export`: files by their ending."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import Result

from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import StoreOptions, load_settings
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.messages.exports import ExportRequest
from tests.api.made_scene import add_scene
from tests.api.upright_scene import add_upright_scene
from tests.commands import invoke

Run = Callable[..., Result]


def test_a_scene_is_written_as_its_ending_says(fastsplat: Run, service: SceneService, tmp_path: Path) -> None:
    scene_id, upright_id = add_scene(service, load_settings()), add_upright_scene(service, load_settings())
    for name, more, request in (
        ("a.spz", [], ExportRequest(scene_id, "spz")),
        ("a.sog", ["--object", "2"], ExportRequest(scene_id, "sog", object_ids=(2,))),
        ("a.PLY", [], ExportRequest(scene_id, "ply")),
        ("b.ply", ["--object", "2"], ExportRequest(scene_id, "ply", object_ids=(2,))),
        ("c.bin", ["--format", "spz"], ExportRequest(scene_id, "spz")),
        ("d.points.ply", ["--cell", "0.2"], ExportRequest(scene_id, "points", cell=0.2)),
        ("D.glb", [], ExportRequest(scene_id, "mesh")),
        ("e.mcap", ["--object", "2"], ExportRequest(scene_id, "mcap", object_ids=(2,))),
        ("floor.map.zip", ["--cell", "0.1"], ExportRequest(upright_id, "map", cell=0.1)),
    ):
        result = fastsplat("scenes", "export", request.scene_id, str(tmp_path / name), *more)
        assert result.exit_code == 0, result.output
        assert (tmp_path / name).read_bytes() == service.exports.file(request)
    result = fastsplat("scenes", "export", scene_id, str(tmp_path / "a.obj"))
    assert isinstance(result.exception, InvalidInputError) and not (tmp_path / "a.obj").exists()


def test_detections_are_printed_whole(service: SceneService, monkeypatch: pytest.MonkeyPatch) -> None:
    scene_id = add_upright_scene(service, load_settings())
    paged_by_one = load_settings().model_copy(update={"store": StoreOptions(max_page_size=1)})
    monkeypatch.setattr("fastsplat.cli.connection.load_settings", lambda: paged_by_one)
    printed = json.loads(invoke("objects", "detections", scene_id, "--json").stdout)
    truth = service.answers.detections(scene_id)
    assert len(truth.detections) == 2 and printed["next_page_token"] == ""
    assert [row["label"] for row in printed["detections"]] == [detection.label for detection in truth.detections]
