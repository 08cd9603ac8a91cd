"""`fastsplat things`: what a scene holds is listed, picked and named from the command line."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from fastsplat.cli.main import app
from fastsplat.service.application.service import open_service
from fastsplat.service.settings import load_settings
from fastsplat_contract.errors import ConflictError, NotFoundError
from tests.api.made_scene import ENCODER, add_known_name, add_scene, write_words


@pytest.fixture
def scene_id(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    write_words(tmp_path / "models")
    monkeypatch.setenv("FASTSPLAT_DATA_DIR", str(tmp_path / "data"))
    monkeypatch.setenv("FASTSPLAT_MODELS", str(tmp_path / "models"))
    monkeypatch.setenv("FASTSPLAT_PERCEPTION__TEXT_ENCODER", ENCODER)
    monkeypatch.setenv("COLUMNS", "240")
    load_settings.cache_clear()
    with open_service(load_settings()) as service:
        yield add_scene(service, load_settings())
    load_settings.cache_clear()


@pytest.fixture
def things() -> Callable[..., Result]:
    return lambda *words: CliRunner().invoke(app, ["things", *words])


def test_a_thing_is_picked_named_and_listed(things: Callable[..., Result], scene_id: str) -> None:
    picked = json.loads(things("pick", scene_id, "--view", "front.png", "--pixel", "15.5", "18.5").stdout)
    assert picked["thing"]["name"] == "mug" and picked["mask"]["area"] > 20
    thing_id = str(picked["thing"]["id"])
    named = things("name", scene_id, "violin", thing_id, "--alias", "moon", "--looked-at", picked["version"])
    assert named.exit_code == 0 and named.stdout.startswith("version e")
    assert "violin" in things("list", scene_id).stdout
    rows = json.loads(things("list", scene_id, "--json").stdout)
    assert [(row["id"], row["name"]) for row in rows] == [(1, "violin"), (2, "ball"), (3, "story book")]
    assert isinstance(things("name", scene_id, "carrot", thing_id).exception, ConflictError)
    assert things("merge", scene_id, "2", "3").exit_code == 0
    assert things("discard", scene_id, "2").exit_code == 0
    assert isinstance(things("unname", scene_id, "1").exception, ConflictError)
    assert [row["id"] for row in json.loads(things("list", scene_id, "--json").stdout)] == [1]
    for _ in range(3):
        undone = things("undo", scene_id)
    assert undone.stdout == "version 1 is current\n"
    point = [str(value) for value in rows[1]["box"]["center"]["position"].values()]
    assert json.loads(things("pick", scene_id, "--point", *point).stdout)["thing"]["name"] == "ball"


def test_what_people_named_is_shown_and_forgotten(things: Callable[..., Result], scene_id: str) -> None:
    with open_service(load_settings()) as service:
        name_id = add_known_name(service, scene_id, "violin")
    shown = things("known")
    assert name_id in shown.stdout and "violin" in shown.stdout
    assert isinstance(things("known", "--forget", "0" * 32).exception, NotFoundError)
    assert name_id not in things("known", "--forget", name_id).stdout
    with open_service(load_settings()) as service:
        add_known_name(service, scene_id)
    assert name_id in things("known").stdout
    assert name_id not in things("known", "--forget-all").stdout


def test_what_is_not_there_says_so(things: Callable[..., Result], scene_id: str) -> None:
    assert isinstance(things("list", "0" * 32).exception, NotFoundError)
    assert isinstance(things("discard", scene_id, "9").exception, NotFoundError)
    assert isinstance(things("list", scene_id, "--project", "elsewhere").exception, NotFoundError)
