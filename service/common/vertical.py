"""The vertical direction, estimated from how people hold cameras."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

_LEVEL = 0.25
_LEAST_AGREEMENT = 0.5
_LEAST_TURNED = 0.003  # mean square sine of the angles between the x axes: cameras 3 degrees apart or more


def vertical_of_poses(world_from_camera: F64) -> F64 | None:
    """The unit vector up, float64 [3], of poses [N, 4, 4], OpenCV axes; None where they do not tell.

    Cameras are held level: the vertical is the smallest principal axis of their x axes, on the side of their −y axes;
    None where the second is not much larger.
    """
    if len(world_from_camera) < 3:
        return None
    across, up = world_from_camera[:, :3, 0], -world_from_camera[:, :3, 1].mean(axis=0)
    values, vectors = np.linalg.eigh(across.T @ across / len(across))
    axis = vectors[:, 0]
    if values[1] < _LEAST_TURNED or values[0] > _LEVEL * values[1] or abs(axis @ up) < _LEVEL:
        return None
    return np.asarray(axis if axis @ up > 0 else -axis)


def mean_up(world_from_camera: F64) -> F64 | None:
    """The unit vector of the mean of the pictures' upward directions, float64 [3], of poses [N, 4, 4]; None where these
    hardly agree. It leans to where cameras that look down stand closest."""
    mean = -world_from_camera[:, :3, 1].mean(axis=0)
    length = float(np.linalg.norm(mean))
    return None if length < _LEAST_AGREEMENT else np.asarray(mean / length)


def level_deviation(world_from_camera: F64, up: F64) -> float:
    """How sure the vertical of `vertical_of_poses` is: 1 sigma of its angle, degrees, at least 0.2, as of a normal
    fitted to x axes by least squares."""
    across = world_from_camera[:, :3, 0]
    variance = float(((across @ up) ** 2).sum()) / max(1, len(across) - 2)
    values = np.linalg.eigvalsh(across.T @ across)[1:]
    return max(0.2, float(np.degrees(np.sqrt((variance / values).sum()))))
