"""Oriented boxes aligned with the scene's vertical."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat_contract.geometry.poses import Box, Pose, Vector3, quaternion_of, vector3

F64 = NDArray[np.float64]

BOX_TRIM = 0.015
"""Share of the weight that a box cuts off at either end of each axis."""


def oriented_box(points: F64, weights: F64, up: F64 | None) -> Box:
    """Fits a box to weighted points [K, 3], K ≥ 1.

    The z axis is `up`, else the direction of least spread. The base is the rectangle of least area, its longer side x.
    1.5 % of the weight is trimmed at either end of each axis of spread.
    """
    center = np.average(points, axis=0, weights=weights)
    offsets = points - center
    spread = np.linalg.eigh((offsets * weights[:, None]).T @ offsets)[1].T
    third = spread[0] if up is None else up
    first = np.cross(np.eye(3)[np.abs(third).argmin()], third)
    first /= np.linalg.norm(first)
    second = np.cross(third, first)
    inner = np.ones(len(points), dtype=np.bool_)
    for axis in (*spread, third):
        along = offsets @ axis
        low, high = trimmed_ends(along, weights)
        inner &= (along >= low) & (along <= high)
    inliers = offsets[inner] if inner.any() else offsets
    flat = np.stack([inliers @ first, inliers @ second], axis=1)
    heights = inliers @ third
    (x, y), (width, depth), degrees = _rectangle(flat)
    if width < depth:
        width, depth, degrees = depth, width, degrees + 90.0
    angle = np.deg2rad(degrees)
    along, aside = np.cos(angle) * first + np.sin(angle) * second, np.cos(angle) * second - np.sin(angle) * first
    middle = (heights.max() + heights.min()) / 2
    axes = np.stack([along, aside, third], axis=1)
    return Box(
        center=Pose(vector3(center + x * first + y * second + middle * third), quaternion_of(axes)),
        size=Vector3(float(width), float(depth), float(heights.max() - heights.min())),
    )


def _rectangle(flat: F64) -> tuple[tuple[float, float], tuple[float, float], float]:
    """Returns center, sides and angle (degrees) of the minimum-area rectangle of points [K, 2].

    Scales the points first: OpenCV computes in float32 and treats lengths below 1e-7 as zero.
    """
    scale = max(float(np.abs(flat).max()), np.finfo(np.float64).tiny) / 1000.0
    (x, y), (width, depth), degrees = cv2.minAreaRect((flat / scale).astype(np.float32))
    return (x * scale, y * scale), (width * scale, depth * scale), float(degrees)


def trimmed_ends(values: F64, weights: F64) -> tuple[float, float]:
    """Returns the range of values [K], K ≥ 1, trimmed by `BOX_TRIM` of the weight."""
    order = values.argsort(kind="stable")
    reached = weights[order].cumsum()
    low, high = np.searchsorted(reached, [BOX_TRIM * reached[-1], (1 - BOX_TRIM) * reached[-1]])
    return float(values[order[low]]), float(values[order[min(int(high), len(values) - 1)]])
