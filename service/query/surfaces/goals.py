"""Navigation goals: the nearest free place from which a robot sees an object."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from fastsplat.service.query.surfaces.occupancy import FREE, OccupancyMap
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.geometry.poses import Box, Pose, Quaternion, Vector3, rigid
from fastsplat_contract.messages.goals import Goal
from fastsplat_contract.messages.objects import SceneObject

F64 = NDArray[np.float64]

MARGIN = 0.05
"""Clearance around a robot beyond its radius, meters."""
FARTHEST = 3.0
"""Largest distance from an object's box to a goal, meters."""


def goal_near(known: OccupancyMap, obj: SceneObject, robot_radius: float, version: str = "") -> Goal:
    """Finds the free place nearest to an object from which a robot sees it.

    All cells within `robot_radius` (meters) + `MARGIN` are free and clear of the object's box, unless the box is
    entirely above the map's height band. The place is at most `FARTHEST` from the box. The line from the top of the
    band above the place to the top of the box passes over everything in between except the object itself; whatever
    reaches the top of the band hides everything behind it.

    Raises:
        InvalidInputError: an invalid radius, an object without a box, or a doubtful floor.
        NotFoundError: there is no such place.
    """
    if not (math.isfinite(robot_radius) and robot_radius > 0):
        raise InvalidInputError(f"a robot's radius of {robot_radius} m", field="robot_radius", hint="Meters, above 0.")
    box = obj.box
    if box is None:
        raise InvalidInputError(
            f"object {obj.id} has no box: it is too faint to be seen", field="object_id", hint="Choose another object."
        )
    if known.floor_doubt:
        raise InvalidInputError(
            f"no floor is known to stand on: the lowest level is at z = {known.floor:.2f} m, and {known.floor_doubt}",
            field="scene_id",
            hint="Take photos that show the floor; or, if this is the floor, name its object 'floor'.",
        )
    free = np.pad(known.cells == FREE, 1)
    apart = np.asarray(distance_transform_edt(free), np.float64)[1:-1, 1:-1]
    room = np.maximum(apart - math.sqrt(0.5), 0.0) * known.resolution  # meters from cell centers to a non-free edge
    rows, columns = np.nonzero(room >= robot_radius + MARGIN)
    places = np.stack([columns + 0.5, rows + 0.5], axis=1) * known.resolution + known.origin
    distances = _distances(places, box)
    order = np.lexsort((columns, rows, distances.round(9)))
    # Parts of the object below the band, or poorly seen, still take up the room of its box.
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
            return Goal(pose, yaw, float(distances[row]), clearance, obj.id, version, known.floor_source)
    raise NotFoundError(
        f"no free place for a robot of {robot_radius:g} m within {FARTHEST:g} m from which the object is seen",
        field="object_id",
        hint="Ask for a smaller radius, or take photos that show more of the floor around it.",
    )


def _distances(places: F64, box: Box, margin: float = 0.0) -> F64:
    """Distances of places [K, 2] from an upright box widened by `margin`, float64 [K]."""
    pose = rigid(box.center.orientation, box.center.position)
    local = (places - pose[:2, 3]) @ pose[:2, :2]
    outside = np.abs(local) - (np.array(box.size[:2]) / 2 + margin)
    return np.asarray(np.linalg.norm(np.maximum(outside, 0.0), axis=1))


def _sees(known: OccupancyMap, place: F64, box: Box) -> bool:
    """True if nothing blocks the line from above a place to a box's top."""
    center = np.array(box.center.position)
    eye = np.array([*place, known.floor + known.height])
    target = center + np.array([0, 0, box.size[2] / 2])
    count = max(2, math.ceil(np.linalg.norm(center[:2] - place) / (known.resolution / 4)))
    line = eye + np.linspace(0, 1, count)[:, None] * (target - eye)
    cells = np.floor((line[:, :2] - known.origin) / known.resolution).astype(np.int64)
    depth, width = known.cells.shape
    inside = ((cells >= 0) & (cells < [width, depth])).all(axis=1)
    line, tops = line[inside], known.tops[cells[inside, 1], cells[inside, 0]].astype(np.float64)
    # The object does not hide itself: ignore cells inside its box that are no higher than it.
    in_object = (_distances(line[:, :2], box, 2 * known.resolution) == 0) & (tops <= target[2] + known.resolution)
    # Heights are sampled a cell apart, so a cell that nearly reaches the top of the band counts as going above it.
    tops[tops > known.floor + known.height - 2 * known.resolution] = np.inf
    return bool((in_object | (line[:, 2] > tops)).all())
