"""Estimates the vertical from how people hold cameras."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

_LEVEL = 0.25
_LEAST_AGREEMENT = 0.5
_LEAST_TURNED = 0.003  # mean squared sine of angles between x axes: cameras at least 3 degrees apart


def vertical_of_poses(world_from_camera: F64) -> F64 | None:
    """Returns the unit up vector [3] of OpenCV poses [N, 4, 4]; None if ambiguous.

    Cameras are held level: the vertical is the smallest principal axis of their x axes, on the side of their −y axes.
    Ambiguous unless the second is much larger.
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
    """Mean image-up direction of poses [N, 4, 4], biased by down-looking cameras; None without agreement."""
    mean = -world_from_camera[:, :3, 1].mean(axis=0)
    length = float(np.linalg.norm(mean))
    return None if length < _LEAST_AGREEMENT else np.asarray(mean / length)


def level_deviation(world_from_camera: F64, up: F64) -> float:
    """Standard error of `vertical_of_poses` in degrees, 1 sigma, at least 0.2."""
    across = world_from_camera[:, :3, 0]
    variance = float(((across @ up) ** 2).sum()) / max(1, len(across) - 2)
    values = np.linalg.eigvalsh(across.T @ across)[1:]
    return max(0.2, float(np.degrees(np.sqrt((variance / values).sum()))))
