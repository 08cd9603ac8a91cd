"""Where a robot stands to see an object: free as far as it is wide, near, in sight, in every frame; or nowhere."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
import pytest

from fastsplat.service.query.surfaces.goals import FARTHEST, MARGIN, goal_near
from fastsplat.service.query.surfaces.occupancy import FREE, OccupancyMap, occupancy_map
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.geometry.poses import Box, Pose, Vector3, quaternion_of, vector3
from fastsplat_contract.messages.goals import Goal
from fastsplat_contract.messages.objects import SceneObject
from tests.query.room import Solid, floor, turned, views_of

_CHEST = Solid((0.4, 0.1, 0.0), (1.1, 0.7, 0.6), 1)
_STILL = np.eye(4)
_ANY = SceneObject(1, "chest", None, 0.0, (), "object", "", 1.0, 10, None, True)


def _map(solids: Sequence[Solid], motion: np.ndarray = _STILL) -> OccupancyMap:
    views = views_of((floor(), *solids), motion=motion)
    return occupancy_map(views, (9,), {}, resolution=0.05, height=1.5, most_points=10**6, most_cells=10**6)


def _object(solid: Solid, motion: np.ndarray = _STILL) -> SceneObject:
    low, high = np.array(solid.low), np.array(solid.high)
    center = motion[:3, :3] @ ((low + high) / 2) + motion[:3, 3]
    box = Box(Pose(vector3(center), quaternion_of(motion[:3, :3])), Vector3(*(high - low).tolist()))
    return dataclasses.replace(_ANY, id=solid.object_id, box=box)


def _local(goal: Goal, motion: np.ndarray) -> np.ndarray:
    """The place of a goal before the motion."""
    return (np.array(goal.pose.position) - motion[:3, 3]) @ motion[:3, :3]


def _outside(place: np.ndarray, solid: Solid) -> float:
    low, high = np.array(solid.low[:2]), np.array(solid.high[:2])
    return float(np.linalg.norm(np.maximum(np.maximum(low - place[:2], place[:2] - high), 0)))


@pytest.mark.parametrize("radius", [0.1, 0.25, 0.4])
@pytest.mark.parametrize("motion", [_STILL, turned(np.pi / 2, 3, -2, 1), turned(0.6, -5.02, 4.1, -0.3)])
def test_a_goal_is_free_near_and_looks_at_the_object(radius: float, motion: np.ndarray) -> None:
    known = _map([_CHEST], motion)
    goal = goal_near(known, _object(_CHEST, motion), radius, "7")
    x, y, z = goal.pose.position
    assert z == known.floor == pytest.approx(motion[2, 3], abs=0.01)
    rows, columns = np.indices(known.cells.shape)
    apart = np.hypot(
        (columns + 0.5) * known.resolution + known.origin[0] - x, (rows + 0.5) * known.resolution + known.origin[1] - y
    )
    assert (known.cells[apart < radius + MARGIN] == FREE).all()
    distance = _outside(_local(goal, motion), _CHEST)
    assert goal.distance == pytest.approx(distance, abs=1e-6)
    assert radius + MARGIN <= goal.clearance <= distance + known.resolution
    assert distance < radius + MARGIN + 3 * known.resolution  # in every frame as near as its width lets it
    ahead = goal.pose.matrix()[:3, 0]
    box = _object(_CHEST, motion).box
    assert box is not None
    offset = np.array(box.center.position)[:2] - (x, y)
    np.testing.assert_allclose(ahead, [*(offset / np.linalg.norm(offset)), 0], atol=1e-9)
    assert goal.yaw == pytest.approx(math.atan2(ahead[1], ahead[0]))
    assert (goal.object_id, goal.version) == (1, "7")


def test_what_stands_on_a_chest_is_seen_over_it() -> None:
    cup = Solid((0.5, 0.5, 0.6), (0.6, 0.6, 0.7), 2)
    goal = goal_near(_map([_CHEST, cup]), _object(cup), 0.2)
    place = _local(goal, _STILL)
    assert _outside(place, _CHEST) >= 0.2 and _outside(place, cup) < 0.5


def test_what_a_wall_hides_is_seen_from_its_other_side_alone() -> None:
    wall = Solid((-1.5, 0.25, 0.0), (1.5, 0.3, 1.55), 3)
    near = Solid((-0.2, -0.25, 0.0), (0.2, 0.15, 0.3), 4)
    assert _local(goal_near(_map([wall, near]), _object(near), 0.2), _STILL)[1] < 0.25
    step = Solid((-1.5, 0.3, 0.0), (1.5, 1.1, 0.2), 5)  # keeps the robot farther away on the side that sees it
    behind = Solid((-0.2, 0.3, 0.2), (0.2, 0.5, 0.4), 4)
    goal = goal_near(_map([wall, step, behind]), _object(behind), 0.2)
    assert _local(goal, _STILL)[1] > 1.3 and goal.distance > 0.8


def test_an_enclosed_object_has_no_goal_and_a_gate_as_wide_as_the_robot_is_needed() -> None:
    inner = Solid((-0.1, -0.1, 0.0), (0.1, 0.1, 0.3), 5)
    fence = [
        Solid((-0.9, -0.9, 0.0), (0.9, -0.8, 1.55), 6),
        Solid((-0.9, 0.8, 0.0), (0.9, 0.9, 1.55), 6),
        Solid((-0.9, -0.8, 0.0), (-0.8, 0.8, 1.55), 6),
        Solid((0.8, -0.8, 0.0), (0.9, 0.8, 1.55), 6),
    ]
    with pytest.raises(NotFoundError) as nowhere:
        goal_near(_map([inner, *fence]), _object(inner), 0.5)
    assert nowhere.value.field == "object_id" and "0.5 m" in str(nowhere.value)
    place = _local(goal_near(_map([inner]), _object(inner), 0.5), _STILL)
    assert _outside(place, inner) < 0.8


def test_far_objects_and_bad_radii_and_objects_without_a_box_are_refused() -> None:
    known = _map([_CHEST])
    away = Solid((3.2 + FARTHEST, 0, 0), (3.5 + FARTHEST, 0.3, 0.3), 1)
    with pytest.raises(NotFoundError):
        goal_near(known, _object(away), 0.2)
    for radius in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(InvalidInputError) as refused:
            goal_near(known, _object(_CHEST), radius)
        assert refused.value.field == "robot_radius"
    with pytest.raises(InvalidInputError) as refused:
        goal_near(known, dataclasses.replace(_object(_CHEST), box=None), 0.2)
    assert refused.value.field == "object_id"


def test_a_robot_does_not_stand_on_what_is_too_low_for_the_map() -> None:
    tray = Solid((0.4, 0.1, 0.0), (1.1, 0.7, 0.04), 1)
    goal = goal_near(_map([tray]), _object(tray), 0.2)
    assert goal.distance >= 0.2 + MARGIN
    lamp = dataclasses.replace(_object(tray), box=_lifted(_object(tray).box, 2.0))
    assert goal_near(_map([tray]), lamp, 0.2).distance == 0.0  # under what hangs above the robot it may stand


def _lifted(box: Box | None, height: float) -> Box:
    assert box is not None
    x, y, z = box.center.position
    return dataclasses.replace(box, center=Pose(Vector3(x, y, z + height), box.center.orientation))
