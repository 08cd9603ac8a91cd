"""`fastsplat objects`: what a scene holds is listed, picked, named and measured, and its versions are restored."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest
from typer.testing import Result

from fastsplat.service.application.service import SceneService
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.settings import load_settings
from fastsplat_contract.errors import ConflictError, InvalidInputError, NotFoundError
from tests.api.made_scene import ENCODER, add_known_name, add_scene, parted_scene
from tests.scenes import store_scene

_PICK = ("--view", "front.png", "--pixel", "15.5", "18.5")


def _listed(objects: Callable[..., Result], *words: str) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = json.loads(objects("list", *words, "--json").stdout)["objects"]
    return rows


def test_an_object_is_picked_named_and_listed(objects: Callable[..., Result], scene_id: str) -> None:
    picked = json.loads(objects("pick", scene_id, "--view", "front.png", "--pixel", "15.5", "18.5", "--json").stdout)
    assert picked["object"]["name"] == "mug" and picked["mask"]["area"] > 20
    object_id = str(picked["object"]["id"])
    named = objects("name", scene_id, "violin", object_id, "--alias", "moon", "--looked-at", picked["version"])
    assert named.exit_code == 0 and named.stdout.startswith("version e")
    assert "violin" in objects("list", scene_id).stdout
    rows = _listed(objects, scene_id)
    assert [(row["id"], row["name"]) for row in rows] == [(1, "violin"), (2, "ball"), (3, "story book")]
    assert isinstance(objects("name", scene_id, "carrot", object_id).exception, ConflictError)
    assert objects("merge", scene_id, "2", "3").exit_code == 0
    assert objects("discard", scene_id, "2").exit_code == 0
    assert isinstance(objects("unname", scene_id, "1").exception, ConflictError)
    assert [row["id"] for row in _listed(objects, scene_id)] == [1]
    for _ in range(3):
        undone = objects("undo", scene_id)
    assert undone.stdout == "version 1 is current\n"
    point = [str(value) for value in rows[1]["box"]["center"]["position"].values()]
    assert json.loads(objects("pick", scene_id, "--point", *point, "--json").stdout)["object"]["name"] == "ball"


def test_an_object_of_another_scene_is_inserted_where_it_is_put(
    objects: Callable[..., Result], service: SceneService, scene_id: str
) -> None:
    source_id = add_scene(service, load_settings())
    before = _listed(objects, scene_id)
    half_turn = ["--position", "2", "0", "0.5", "--orientation", "0", "0", "1", "0"]
    inserted = objects("insert", scene_id, source_id, "2", *half_turn)
    assert inserted.exit_code == 0 and inserted.stdout.startswith("version e")
    after = _listed(objects, scene_id)
    assert after[:-1] == before and (after[-1]["id"], after[-1]["name"]) == (4, "ball")
    here, there = (row["box"]["center"]["position"] for row in (before[1], after[-1]))
    moved = (2 - here["x"], -here["y"], here["z"] + 0.5)
    assert tuple(there.values()) == pytest.approx(moved, abs=1e-4)
    assert objects("undo", scene_id).stdout == "version 1 is current\n"
    assert isinstance(objects("insert", scene_id, "0" * 32, "2").exception, NotFoundError)
    assert isinstance(objects("insert", scene_id, source_id, "9").exception, NotFoundError)
    assert isinstance(objects("insert", scene_id, source_id, "2", "--source-version", "e1").exception, NotFoundError)
    long = objects("insert", scene_id, source_id, "2", "--orientation", "0", "0", "0", "2")
    assert isinstance(long.exception, InvalidInputError)
    assert _listed(objects, scene_id) == before


def test_parts_are_listed_under_their_objects(
    objects: Callable[..., Result], service: SceneService, scene_id: str
) -> None:
    assert objects("list", scene_id, "--parts").stdout == objects("list", scene_id).stdout
    parted = store_scene(service._store, parted_scene(open_text_encoder(ENCODER, load_settings().models)))
    lines = objects("list", parted, "--parts").stdout.splitlines()
    assert any(line.startswith("1 ") for line in lines) and any(line.startswith("  4 ") for line in lines)
    rows_of_parts = _listed(objects, parted, "--parts")
    assert [(row["id"], row["parent"]) for row in rows_of_parts] == [(1, 0), (4, 1), (2, 0), (3, 0)]
    assert len(_listed(objects, parted)) == 3
    said = objects("pick", parted, *_PICK).stdout
    assert "in group 7: objects 1, 2" in said and "the mask is of the object" in said
    whole, both = (
        json.loads(objects("pick", parted, *_PICK, *level, "--json").stdout) for level in ((), ("--level", "group"))
    )
    assert (whole["level"], both["level"]) == ("object", "group") and both["mask"]["area"] >= whole["mask"]["area"]


def test_what_people_named_is_shown_and_forgotten(
    objects: Callable[..., Result], service: SceneService, scene_id: str
) -> None:
    name_id = add_known_name(service, scene_id, "violin")
    result = objects("known")
    assert name_id in result.stdout and "violin" in result.stdout
    assert isinstance(objects("known", "--forget", "0" * 32).exception, NotFoundError)
    assert name_id not in objects("known", "--forget", name_id).stdout
    add_known_name(service, scene_id)
    assert name_id in objects("known").stdout
    assert name_id not in objects("known", "--forget", "all").stdout


def test_an_object_is_split_and_a_missing_one_is_added(objects: Callable[..., Result], scene_id: str) -> None:
    def listed() -> dict[int, str]:
        return {obj["id"]: obj["name"] for obj in _listed(objects, scene_id)}

    objects("merge", scene_id, "1", "2")
    place = ("--view", "front.png", "--pixel", "24.5,18.5")
    done = objects("split", scene_id, "1", *place, "--beside", "15.5,18.5", "--name", "violin", "--alias", "moon")
    assert done.exit_code == 0 and done.stdout.startswith("object 4 has "), done.stdout
    assert listed() == {1: "mug", 3: "story book", 4: "violin"}
    looked_at = json.loads(objects("pick", scene_id, *_PICK, "--json").stdout)["version"]
    objects("discard", scene_id, "4", "--looked-at", looked_at)
    done = objects("add", scene_id, "--view", "front.png", "--box", "20", "13", "29", "22")
    assert done.exit_code == 0 and listed() == {1: "mug", 3: "story book", 5: ""}
    assert isinstance(objects("add", scene_id, "--view", "front.png", "--pixel", "24").exception, InvalidInputError)
    assert isinstance(objects("split", scene_id, "1", "--pixel", "2,2").exception, InvalidInputError)


def test_a_question_is_asked_from_where_one_stands(fastsplat: Callable[..., Result], scene_id: str) -> None:
    said = fastsplat("ask", scene_id, "the object left of the ball", "--from", "front.png")
    assert said.exit_code == 0 and "mug" in said.stdout
    result = fastsplat("ask", scene_id, "the object left of the ball", "--pose", "0,0,8,0,1,0,0", "--json")
    (behind,) = json.loads(result.stdout)["answers"]
    assert behind["object_ids"] == [3] and behind["phrase"]["witnesses"]
    assert "depends on where you stand" in fastsplat("ask", scene_id, "the object left of the ball").stdout
    assert isinstance(fastsplat("ask", scene_id, "mug", "--pose", "1,2").exception, InvalidInputError)


def test_a_scene_is_cropped_as_its_preview_says(fastsplat: Callable[..., Result], scene_id: str) -> None:
    box = ("--center", "0", "0", "4", "--size", "1.5", "9", "9", "--outside")
    preview = json.loads(fastsplat("scenes", "clean", scene_id, *box, "--preview", "--json").stdout)
    assert 0 < preview["count"] < preview["gaussians"]
    version = json.loads(fastsplat("scenes", "clean", scene_id, *box, "--json").stdout)
    assert version["gaussians"] == preview["gaussians"] - preview["count"] and version["parent"] == preview["version"]
    assert fastsplat("objects", "undo", scene_id).exit_code == 0
    refused = fastsplat("scenes", "clean", scene_id, "--center", "0", "0", "4").exception
    assert isinstance(refused, InvalidInputError) and refused.field == "edits[0].filter.box.size"


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
