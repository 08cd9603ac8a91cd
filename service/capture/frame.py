"""The world frame of a reconstruction that has none of its own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_MIN_AGREEMENT = 0.5
_MEDIAN_DEPTH = 3.0


def settle(
    world_from_camera: NDArray[np.float64], points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Move, turn and scale cameras [N, 4, 4] and points [P, 3] alike; returns float64 arrays of the same shapes.

    The points' median becomes the origin and the median distance from a camera to it becomes 3, so that a scene's
    numbers are of the order of one. +z becomes the mean of the photos' upward directions, if they agree: people hold
    cameras upright.
    """
    rotation = _upright(-world_from_camera[:, :3, 1])
    centre = np.median(points, axis=0)
    distance = float(np.median(np.linalg.norm(world_from_camera[:, :3, 3] - centre, axis=1)))
    scale = _MEDIAN_DEPTH / distance
    settled = world_from_camera.copy()
    settled[:, :3, :3] = rotation @ world_from_camera[:, :3, :3]
    settled[:, :3, 3] = scale * (world_from_camera[:, :3, 3] - centre) @ rotation.T
    return settled, scale * (points - centre) @ rotation.T


def _upright(ups: NDArray[np.float64]) -> NDArray[np.float64]:
    """The smallest rotation that takes the mean of unit vectors [N, 3] to +z; identity if they disagree."""
    mean = ups.mean(axis=0)
    if np.linalg.norm(mean) < _MIN_AGREEMENT:
        return np.eye(3)
    up = mean / np.linalg.norm(mean)
    axis = np.cross(up, [0.0, 0.0, 1.0])
    if up[2] < -1 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1 + up[2]))
