"""Where a robot stands to see a thing: the free place nearest to it, by the map of the floor."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from fastsplat.service.query.surfaces.occupancy import FREE, OccupancyMap
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.geometry.poses import Box, Pose, Quaternion, Vector3, rigid
from fastsplat_contract.messages.goals import Goal
from fastsplat_contract.messages.things import SceneThing

F64 = NDArray[np.float64]

MARGIN = 0.05
"""Meters that stay free around a robot, beside its radius."""
FARTHEST = 3.0
"""Meters from a thing's box within which a robot stands to see it."""


def goal_near(known: OccupancyMap, thing: SceneThing, robot_radius: float, version: str = "") -> Goal:
    """The free place nearest to a thing from which a robot sees it.

    All cells within `robot_radius` and `MARGIN` of it are free, so is the thing's box, unless it is all above the band
    of the map; it is at most `FARTHEST` from the box, and the line
    from the top of the band over it to the top of the box passes over all that stands between, but the thing itself.
    What reaches the top of the band hides everything behind it.

    Args:
        known: the map.
        thing: its box is in the frame of the map.
        robot_radius: meters.
        version: of the scene, to be named in the answer.

    Raises:
        InvalidInputError: a radius that is none, a thing without a box, or what was taken for the floor may be none.
        NotFoundError: there is no such place.
    """
    if not (math.isfinite(robot_radius) and robot_radius > 0):
        raise InvalidInputError(f"a robot's radius of {robot_radius} m", field="robot_radius", hint="Meters, above 0.")
    box = thing.box
    if box is None:
        raise InvalidInputError(
            f"thing {thing.id} has no box: it is too faint to be seen", field="thing_id", hint="Choose another thing."
        )
    if known.floor_doubt:
        raise InvalidInputError(
            f"no floor is known to stand on: the lowest level is at z = {known.floor:.2f} m, and {known.floor_doubt}",
            field="scene_id",
            hint="Take photos that show the floor; or, if this is the floor, name its thing 'floor'.",
        )
    room = _clearance(known)
    rows, columns = np.nonzero(room >= robot_radius + MARGIN)
    places = np.stack([columns + 0.5, rows + 0.5], axis=1) * known.resolution + known.origin
    distances = _distances(places, box)
    order = np.lexsort((columns, rows, distances.round(9)))
    # What is lower than the map's surfaces begin, or was not seen well, still takes up the room of its box.
    overhead = box.center.position.z - box.size.z / 2 > known.floor + known.height
    nearest = 0.0 if overhead else robot_radius + MARGIN
    near_enough = (distances[order] >= nearest) & (distances[order] <= FARTHEST)
    for row in order[near_enough].tolist():
        if _sees(known, places[row], box):
            x, y = places[row].tolist()
            yaw = math.atan2(box.center.position.y - y, box.center.position.x - x)
            turn = Quaternion(0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
            pose = Pose(Vector3(x, y, known.floor), turn)
            clearance = float(room[rows[row], columns[row]])
            return Goal(pose, yaw, float(distances[row]), clearance, thing.id, version, known.floor_source)
    raise NotFoundError(
        f"no free place for a robot of {robot_radius:g} m within {FARTHEST:g} m from which the thing is seen",
        field="thing_id",
        hint="Ask for a smaller radius, or take photos that show more of the floor around it.",
    )


def _clearance(known: OccupancyMap) -> F64:
    """float64 [H, W]: meters from the middle of a free cell to the nearest edge of one that is not; 0 for others."""
    free = np.pad(known.cells == FREE, 1)
    apart = np.asarray(distance_transform_edt(free), np.float64)[1:-1, 1:-1]
    return np.asarray(np.maximum(apart - math.sqrt(0.5), 0.0) * known.resolution)


def _distances(places: F64, box: Box, margin: float = 0.0) -> F64:
    """float64 [K]: of places [K, 2] from the rectangle of an upright box that is wider by `margin` on each side."""
    pose = rigid(box.center.orientation, box.center.position)
    local = (places - pose[:2, 3]) @ pose[:2, :2]
    outside = np.abs(local) - (np.array(box.size[:2]) / 2 + margin)
    return np.asarray(np.linalg.norm(np.maximum(outside, 0.0), axis=1))


def _sees(known: OccupancyMap, place: F64, box: Box) -> bool:
    """Whether nothing stands between the top of the band over a place and the top of a box."""
    center = np.array(box.center.position)
    eye = np.array([*place, known.floor + known.height])
    target = center + np.array([0, 0, box.size[2] / 2])
    count = max(2, math.ceil(np.linalg.norm(center[:2] - place) / (known.resolution / 4)))
    line = eye + np.linspace(0, 1, count)[:, None] * (target - eye)
    cells = np.floor((line[:, :2] - known.origin) / known.resolution).astype(np.int64)
    depth, width = known.cells.shape
    inside = ((cells >= 0) & (cells < [width, depth])).all(axis=1)
    line, tops = line[inside], known.tops[cells[inside, 1], cells[inside, 0]].astype(np.float64)
    # The thing does not hide itself: what is at its place, no higher than it.
    own = (_distances(line[:, :2], box, 2 * known.resolution) == 0) & (tops <= target[2] + known.resolution)
    # Cells are as high as their points are apart: one that nearly reaches the top of the band goes on above it.
    tops[tops > known.floor + known.height - 2 * known.resolution] = np.inf
    return bool((own | (line[:, 2] > tops)).all())
