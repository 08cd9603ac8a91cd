"""`fastsplat things measure`, `scale`, `redo`, `restore` and `versions` from the command line."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner, Result

from fastsplat.cli.main import app
from fastsplat_contract.errors import InvalidInputError
from tests.cli.test_things import scene_id as scene_id


def _things(*words: str) -> Result:
    return CliRunner().invoke(app, ["things", *words])


def test_a_scene_is_measured_and_scaled(scene_id: str) -> None:
    size = json.loads(_things("measure", scene_id, "1", "--json").stdout)
    assert len(size["sides"]) == 3 and size["meters"]
    apart = json.loads(_things("measure", scene_id, "front.png:15.5,18.5", "0.5,0,0", "--json").stdout)
    assert apart["places"][0]["thing_id"] == 1 and apart["distance"]["low"] < apart["distance"]["value"]
    scaled = _things("scale", scene_id, "0,0,0", "0.5,0,0", "0.25", "--plus-minus", "0.001")
    assert scaled.exit_code == 0 and scaled.stdout.startswith("a unit of the trained scene is 0.5 m (")
    again = json.loads(_things("measure", scene_id, "1", "--json").stdout)
    assert again["sides"][0]["value"] == pytest.approx(size["sides"][0]["value"] / 2, rel=1e-3)
    for words in (("measure", scene_id, "front.png:1"), ("scale", scene_id, "0,0,0", "1,0,0", "0")):
        assert isinstance(_things(*words).exception, InvalidInputError)


def test_versions_are_listed_redone_and_restored(scene_id: str) -> None:
    made = _things("name", scene_id, "violin", "1").stdout.split()[1]
    assert "* " in _things("versions", scene_id).stdout
    assert _things("undo", scene_id).stdout == "version 1 is current\n"
    assert _things("redo", scene_id).stdout == f"version {made} is current\n"
    assert _things("restore", scene_id, "1").stdout == "version 1 is current\n"
    rows = json.loads(_things("versions", scene_id, "--json").stdout)["versions"]
    assert [(row["version"], row["current"], row["author"]) for row in rows] == [("1", True, ""), (made, False, "")]
