"""`fastsplat objects measure`, `scale`, `redo`, `restore` and `versions` from the command line."""

from __future__ import annotations

import json
from collections.abc import Callable

import pytest
from typer.testing import Result

from fastsplat_contract.errors import InvalidInputError


def test_a_scene_is_measured_and_scaled(objects: Callable[..., Result], scene_id: str) -> None:
    size = json.loads(objects("measure", scene_id, "1", "--json").stdout)
    assert len(size["sides"]) == 3 and size["meters"]
    apart = json.loads(objects("measure", scene_id, "front.png:15.5,18.5", "0.5,0,0", "--json").stdout)
    assert apart["places"][0]["object_id"] == 1 and apart["distance"]["low"] < apart["distance"]["value"]
    scaled = objects("scale", scene_id, "0,0,0", "0.5,0,0", "0.25", "--plus-minus", "0.001")
    assert scaled.exit_code == 0 and scaled.stdout.startswith("a unit of the trained scene is 0.5 m (")
    again = json.loads(objects("measure", scene_id, "1", "--json").stdout)
    assert again["sides"][0]["value"] == pytest.approx(size["sides"][0]["value"] / 2, rel=1e-3)
    by_size = objects("scale", scene_id, "1", "0.3", "--height")
    assert by_size.exit_code == 0 and "by 2 known lengths" in by_size.stdout
    lengths = (("0,0,0", "1,0,0", "0"), ("0,0,0", "1"), ("0,0,0", "1,0,0", "1", "--height"), ("1", "2", "1,0,0", "1"))
    for words in (("measure", scene_id, "front.png:1"), *(("scale", scene_id, *length) for length in lengths)):
        assert isinstance(objects(*words).exception, InvalidInputError)


def test_versions_are_listed_redone_and_restored(objects: Callable[..., Result], scene_id: str) -> None:
    version = objects("name", scene_id, "violin", "1").stdout.split()[1]
    assert "* " in objects("versions", scene_id).stdout
    assert objects("undo", scene_id).stdout == "version 1 is current\n"
    assert objects("redo", scene_id).stdout == f"version {version} is current\n"
    assert objects("restore", scene_id, "1").stdout == "version 1 is current\n"
    rows = json.loads(objects("versions", scene_id, "--json").stdout)["versions"]
    assert [(row["version"], row["current"], row["author"]) for row in rows] == [("1", True, ""), (version, False, "")]
