"""A table top is no floor: neither for whoever asks what an object is, nor for a robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fastsplat.service.common.dictionary import Dictionary, DictionaryEntry
from fastsplat.service.query.edits.apply_edit import apply_edit
from fastsplat.service.query.objects.floors import floor_ids, names_a_floor, names_of_others
from fastsplat.service.query.surfaces.goals import goal_near
from fastsplat.service.query.surfaces.occupancy import OccupancyMap, occupancy_map
from fastsplat.service.scene.artefact.scene import NameSource, Object, Objects, Scene, SurfaceKind
from fastsplat.service.scene.objects.label_evidence import evidence_of
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.poses import Box, Pose, Quaternion, Vector3
from fastsplat_contract.messages.objects import SceneObject
from fastsplat_contract.messages.scenes import Edit, Scale
from tests.query.box_scenes import BoxShell, orbit, scene_of
from tests.query.conftest import index_of
from tests.query.room import Solid, around, floor, views_of

_SLAB = BoxShell("floor", (0.0, 0.0, -0.01), (1.0, 1.0, 0.02), count=400)


def _scene(name: str, source: NameSource | None, surface: SurfaceKind, height: float, scale: Scale = "METRIC") -> Scene:
    """One level object, so far below the cameras."""
    bare = scene_of([_SLAB], orbit(8, 1.0, height))
    count = len(bare.gaussians)
    members = evidence_of(np.arange(count), np.ones(count, np.int64), np.full(count, 4096), count)
    obj = Object(1, name, source, 0.9 if name else 0.0, surface=surface)
    return replace(bare, objects=Objects((obj,), members), scale=scale)


@pytest.mark.parametrize("surface", ["floor", "horizontal surface"])
@pytest.mark.parametrize(
    ("name", "source", "height", "scale", "is_floor"),
    [
        ("dining table", "detected", 1.5, "METRIC", False),
        ("dining table", "person", 1.5, "METRIC", False),
        ("dining table", "given", 1.5, "ARBITRARY", False),
        ("wooden floor", "detected", 1.5, "METRIC", True),
        ("wooden floor", "detected", 0.4, "METRIC", False),
        ("wooden floor", "person", 0.4, "METRIC", True),
        ("wooden floor", "given", 0.4, "METRIC", True),
        ("wooden floor", "detected", 0.4, "ARBITRARY", True),
    ],
)
def test_a_name_and_the_height_of_the_cameras_say_what_is_a_floor(
    name: str, source: NameSource, height: float, scale: Scale, is_floor: bool, surface: SurfaceKind
) -> None:
    index = index_of(_scene(name, source, surface, height, scale))
    (obj,) = index.objects.present
    assert obj.surface == ("floor" if is_floor else "horizontal surface")
    assert (index.objects.listed[0].kind, index.objects.listed[0].surface) == ("surface", obj.surface)
    assert floor_ids(index.objects.present, index.scene.dictionary) == ([1] if is_floor else [])


@pytest.mark.parametrize(("height", "is_floor"), [(0.4, False), (1.5, True)])
def test_what_nobody_named_is_a_floor_if_it_lies_low_enough(height: float, is_floor: bool) -> None:
    (obj,) = index_of(_scene("", None, "floor", height)).objects.present
    assert (obj.surface == "floor") == is_floor
    (obj,) = index_of(_scene("", None, "horizontal surface", height)).objects.present
    assert obj.surface == "horizontal surface"


def test_naming_an_object_changes_whether_it_is_a_floor_and_back() -> None:
    index = index_of(_scene("", None, "floor", 1.5))
    for name, surface in (("dining table", "horizontal surface"), ("floor", "floor"), ("rug", "floor"), ("", "floor")):
        edit = Edit("name", object_ids=(1,), name=name) if name else Edit("unname", object_ids=(1,))
        index = index.after(apply_edit(index, edit, index.scene.objects, index.scene.objects))
        assert index.objects.present[0].surface == surface, name
        assert index.scene.objects is not None and index.scene.objects.table[0].surface == "floor", "is kept as it was"


def test_walls_and_lamps_are_no_floors_by_their_names() -> None:
    assert names_a_floor(["floor"]) and names_a_floor(["Floor tiles"]) and names_a_floor(["Boden", "floor"])
    assert names_a_floor(["living-room carpet"]) and names_a_floor(["Rug"])
    for name in ("floor lamp", "table", "tile", "place mat", "floor plan", "", "groundhog"):
        assert not names_a_floor([name]), name
    (wall,) = index_of(_scene("carpet", "person", "wall", 1.5)).objects.present
    assert wall.surface == "wall" and floor_ids([wall], Dictionary(())) == []


def test_an_alias_makes_a_name_a_floors() -> None:
    obj = Object(1, "Boden", "person", 1.0)
    plain, known = (Dictionary((DictionaryEntry("Boden", aliases),)) for aliases in ((), ("ground",)))
    assert floor_ids([obj], plain) == [] and floor_ids([obj], known) == [1]
    assert names_of_others([obj], plain) == {1: "Boden"} and names_of_others([obj], known) == {}
    assert floor_ids([replace(obj, source="detected")], known) == [], "a region without a kind of surface"


_CUP = Solid((0.2, 0.2, 0.0), (0.4, 0.4, 0.3), 2)
_BOX = Box(Pose(Vector3(0.3, 0.3, 0.15), Quaternion(0.0, 0.0, 0.0, 1.0)), Vector3(0.2, 0.2, 0.3))
_OBJECT = SceneObject(2, "cup", None, 0.0, (), "object", "", 1.0, 10, _BOX, True)


def _map(height: float, floors: tuple[int, ...], names: dict[int, str]) -> OccupancyMap:
    views = views_of((floor(), _CUP), around(2.6, height))
    options = {"resolution": 0.05, "height": 1.5, "most_points": 10**6, "most_cells": 10**6}
    return occupancy_map(views, floors, names, **options)


@pytest.mark.parametrize(
    ("height", "names", "reason"),
    [(1.6, {9: "dining table"}, r"object 9, 'dining table'"), (0.5, {}, r"0\.50 m below the cameras")],
)
def test_no_robot_is_sent_onto_a_table_top(height: float, names: dict[int, str], reason: str) -> None:
    known = _map(height, (), names)
    assert known.floor_source == "lowest_level"
    with pytest.raises(InvalidInputError, match=reason) as refused:
        goal_near(known, _OBJECT, 0.2)
    assert refused.value.field == "scene_id" and "name its object 'floor'" in refused.value.hint
    assert goal_near(_map(height, (9,), names), _OBJECT, 0.2).floor_source == "surface", "somebody calls it a floor"


def test_the_lowest_level_counts_where_nothing_speaks_against_it_and_the_goal_says_so() -> None:
    known = _map(1.6, (), {2: "cup"})
    assert known.floor_doubt == "" and goal_near(known, _OBJECT, 0.2).floor_source == "lowest_level"
