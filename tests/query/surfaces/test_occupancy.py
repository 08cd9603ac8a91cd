"""The map of the floor: what it says of rooms whose boxes are known, in whatever frame, and what it refuses."""

from __future__ import annotations

import dataclasses
import io
import zipfile
from collections.abc import Sequence

import numpy as np
import pytest
import yaml
from PIL import Image

from fastsplat.service.application.exporting.map_files import map_file
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.surfaces.occupancy import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    OccupancyMap,
    check_map_frame,
    occupancy_map,
)
from fastsplat.service.query.surfaces.surface_views import SurfaceView
from fastsplat.service.scene.artefact.scene import Scene, SceneFacts
from fastsplat_contract.errors import InvalidInputError, LimitExceededError
from fastsplat_contract.geometry.camera import PosedCamera
from tests.query.conftest import DrawnEncoder
from tests.query.room import CAMERA, Solid, around, floor, turned, views_of
from tests.scenes import labelled_scene

_CHEST = Solid((0.4, 0.1, 0.0), (1.1, 0.7, 0.6), 1)
_PLATE = Solid((-1.0, -0.9, 0.7), (-0.4, -0.3, 0.75), 2)  # a table without legs
_LAMP = Solid((-0.9, 0.5, 1.55), (-0.6, 0.8, 1.6), 3)  # above the robot
_ROOM = (floor(), _CHEST, _PLATE, _LAMP)


def _map(views: Sequence[SurfaceView], floors: Sequence[int] = (9,), **changes: float) -> OccupancyMap:
    options = {"resolution": 0.05, "height": 1.5, "most_points": 10**6, "most_cells": 10**6, **changes}
    return occupancy_map(views, floors, {}, **options)


@pytest.fixture(scope="module")
def room() -> OccupancyMap:
    return _map(views_of(_ROOM))


def _at(known: OccupancyMap, x: np.ndarray | float, y: np.ndarray | float) -> np.ndarray:
    """The cells at places, `UNKNOWN` outside."""
    columns = np.floor((np.atleast_1d(x) - known.origin[0]) / known.resolution).astype(int)
    rows = np.floor((np.atleast_1d(y) - known.origin[1]) / known.resolution).astype(int)
    depth, width = known.cells.shape
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < depth)
    return np.where(inside, known.cells[rows.clip(0, depth - 1), columns.clip(0, width - 1)], UNKNOWN)


def _middles(known: OccupancyMap) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = np.indices(known.cells.shape)
    return (columns + 0.5) * known.resolution + known.origin[0], (rows + 0.5) * known.resolution + known.origin[1]


def _outside(x: np.ndarray, y: np.ndarray, solid: Solid) -> np.ndarray:
    """How far places lie outside the outline of a solid, below 0 inside."""
    sides = [solid.low[0] - x, x - solid.high[0], solid.low[1] - y, y - solid.high[1]]
    return np.max(sides, axis=0)


def test_cells_are_the_drawing_to_within_a_cell(room: OccupancyMap) -> None:
    x, y = _middles(room)
    step = room.resolution
    standing = np.minimum(_outside(x, y, _CHEST), _outside(x, y, _PLATE))
    assert (standing[room.cells == OCCUPIED] < step).all()
    assert (room.cells[standing < -step] != FREE).all()
    top = (_outside(x, y, _CHEST) < -step) | (_outside(x, y, _PLATE) < -step)
    assert (room.cells[top] == OCCUPIED).all()  # seen from above
    clear = (np.hypot(x, y) < 1.8) & (standing > 2 * step)
    assert (room.cells[clear] == FREE).mean() > 0.98 and not (room.cells[clear] == OCCUPIED).any()
    assert (room.cells[_outside(x, y, floor()) > step] == UNKNOWN).all()
    assert (room.floor_source, room.floor) == ("surface", pytest.approx(0, abs=1e-3))


def test_tops_are_those_of_what_stands_there(room: OccupancyMap) -> None:
    x, y = _middles(room)
    for solid in (_CHEST, _PLATE):
        np.testing.assert_allclose(room.tops[_outside(x, y, solid) < -room.resolution], solid.high[2], atol=0.01)
    assert (np.isneginf(room.tops) == (room.cells != OCCUPIED)).all()


def test_what_hangs_above_the_robot_is_in_the_way_of_a_taller_one_only(room: OccupancyMap) -> None:
    x, y = _middles(room)
    assert (room.cells[_outside(x, y, _LAMP) < room.resolution] == FREE).all()
    taller = _map(views_of(_ROOM), height=1.8)
    x, y = _middles(taller)
    assert (taller.cells[np.abs(_outside(x, y, _LAMP)) < taller.resolution] == OCCUPIED).mean() > 0.3  # its sides


def test_behind_a_box_is_unknown_until_another_camera_looks_there() -> None:
    wall = Solid((-0.5, 0.0, 0.0), (0.5, 0.1, 1.2), 1)
    south = [pose for pose in around() if pose[1, 3] < -2.0]
    shadow = np.linspace(-0.3, 0.3, 13), np.full(13, 0.25)
    assert (_at(_map(views_of((floor(), wall), south)), *shadow) == UNKNOWN).all()
    assert (_at(_map(views_of((floor(), wall))), *shadow) == FREE).all()


def test_a_hole_in_the_floor_is_not_free() -> None:
    pieces = [
        Solid((-3, -3, -0.5), (3, -0.4, 0), 9),
        Solid((-3, 0.4, -0.5), (3, 3, 0), 9),
        Solid((-3, -0.4, -0.5), (-0.4, 0.4, 0), 9),
        Solid((0.4, -0.4, -0.5), (3, 0.4, 0), 9),
        Solid((-0.4, -0.4, -0.9), (0.4, 0.4, -0.4), 8),  # the bottom of the hole
    ]
    known = _map(views_of(pieces))
    x, y = _middles(known)
    hole = np.maximum(np.abs(x), np.abs(y)) < 0.35
    assert (known.cells[hole] == UNKNOWN).all()


@pytest.mark.parametrize("angle", [0.0, np.pi / 2, 0.7])
def test_the_map_moves_with_the_scene(room: OccupancyMap, angle: float) -> None:
    motion = turned(angle, 2.35, -7.1, 4.2)
    moved = _map(views_of(_ROOM, motion=motion))
    assert moved.floor == pytest.approx(4.2, abs=1e-3)
    x, y = _middles(room)
    places = np.stack([x.ravel(), y.ravel()]).T @ motion[:2, :2].T + motion[:2, 3]
    there = _at(moved, *places.T).reshape(room.cells.shape)
    step = room.resolution
    edges = np.minimum(np.abs(_outside(x, y, _CHEST)), np.abs(_outside(x, y, _PLATE)))
    inner = (np.hypot(x, y) < 1.8) & (edges > 1.5 * step)
    assert (there == room.cells)[inner].mean() > 0.99


def test_without_an_object_that_is_a_floor_the_lowest_dense_level_counts() -> None:
    for height in (0.0, 1.03):
        known = _map(views_of(_ROOM, motion=turned(0, 0, 0, height)), floors=())
        assert (known.floor_source, known.floor) == ("lowest_level", pytest.approx(height, abs=0.01))
    assert _map(views_of(_ROOM), floors=(77,)).floor_source == "lowest_level"


def test_a_map_is_bounded_and_its_numbers_are_checked() -> None:
    views = views_of(_ROOM)
    for options in ({"most_cells": 1000}, {"most_points": 1000}):
        with pytest.raises(LimitExceededError) as limit:
            _map(views, **options)
        assert limit.value.field == "cell" and limit.value.limit.startswith("1000 ")
    for options in ({"resolution": 0.0}, {"resolution": np.nan}, {"height": 0.1}):
        with pytest.raises(InvalidInputError):
            _map(views, **options)
    with pytest.raises(InvalidInputError):
        _map(views_of([Solid((-1, -1, 3.0), (1, 1, 3.5), 1)]))  # a ceiling alone


def _scene(motion: np.ndarray, **fields: object) -> Scene:
    cameras = [PosedCamera(CAMERA, motion @ pose, f"{n}.png") for n, pose in enumerate(around())]
    return labelled_scene(np.zeros((1, 3)), [1], ["x"], cameras=cameras, **fields)


def test_a_scene_without_meters_or_vertical_is_refused() -> None:
    upright, tipped = _scene(np.eye(4)), np.eye(4)
    tipped[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    check_map_frame(upright)
    with pytest.raises(InvalidInputError, match="meters"):
        check_map_frame(dataclasses.replace(upright, scale="ARBITRARY"))
    with pytest.raises(InvalidInputError, match=r"90\.0 degrees"):
        check_map_frame(_scene(tipped))
    alone = dataclasses.replace(upright, cameras=upright.cameras[:1])
    with pytest.raises(InvalidInputError, match="what is up"):
        check_map_frame(alone)
    unsure = SceneFacts(vertical_source="metadata", vertical_deviation_deg=9.0)
    with pytest.raises(InvalidInputError, match="what is up"):
        check_map_frame(dataclasses.replace(upright, facts=unsure))


def test_other_programs_read_the_map_as_nav2_does() -> None:
    views = tuple(views_of(_ROOM))
    index = SceneIndex(_scene(np.eye(4)), DrawnEncoder(), QuerySettings())
    content = map_file(index, 0.1, lambda _: views)
    assert content == map_file(index, 0.1, lambda _: views)
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert archive.namelist() == ["map.pgm", "map.yaml"]
        words = yaml.safe_load(archive.read("map.yaml"))
        picture = Image.open(io.BytesIO(archive.read(words["image"])))
        shade = np.asarray(picture)
    assert (picture.format, picture.mode) == ("PPM", "L")
    assert (words["resolution"], words["negate"], words["mode"]) == (0.1, 0, "trinary")
    # nav2_map_server: the first row is the farthest in y; occupied above one threshold, free below the other
    share = (255 - shade[::-1].astype(float)) / 255
    read = np.where(share > words["occupied_thresh"], OCCUPIED, np.where(share < words["free_thresh"], FREE, UNKNOWN))
    truth = _map(views, floors=(), resolution=0.1)
    np.testing.assert_array_equal(read, truth.cells)
    assert {FREE, OCCUPIED, UNKNOWN} == set(np.unique(read).tolist())
    x, y, yaw = words["origin"]
    assert ((x, y), yaw) == (truth.origin, 0)
    row, column = int((0.4 - y) / 0.1), int((0.75 - x) / 0.1)
    assert read[row, column] == OCCUPIED  # the middle of the chest
