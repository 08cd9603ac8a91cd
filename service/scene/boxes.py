"""Oriented boxes about the scene's vertical."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat_contract.poses import Box, Pose, Vector3, quaternion_of, vector3

F64 = NDArray[np.float64]

BOX_TRIM = 0.015
"""Share of a thing's weight that a box leaves out at either end of each axis."""


def oriented_box(points: F64, weights: F64, up: F64 | None) -> Box:
    """The box of points [K, 3], K ≥ 1: its z axis is `up`, or the direction of least spread where there is none; its
    base is the rectangle of least area, its x axis the longer side. Of the points 1.5 % by weight are left out at
    either end of each axis of spread.
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
    kept = offsets[inner] if inner.any() else offsets
    flat = np.stack([kept @ first, kept @ second], axis=1)
    heights = kept @ third
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
    """Centre, edge lengths and angle in degrees of the rectangle of least area around points [K, 2]; scaled for
    OpenCV, which counts in float32 and takes lengths below 1e-7 for nothing."""
    scale = max(float(np.abs(flat).max()), np.finfo(np.float64).tiny) / 1000.0
    (x, y), (width, depth), degrees = cv2.minAreaRect((flat / scale).astype(np.float32))
    return (x * scale, y * scale), (width * scale, depth * scale), float(degrees)


def trimmed_ends(values: F64, weights: F64) -> tuple[float, float]:
    """The least and the largest of values [K], K ≥ 1, without 1.5 % by weight at either end."""
    order = values.argsort(kind="stable")
    reached = weights[order].cumsum()
    low, high = np.searchsorted(reached, [BOX_TRIM * reached[-1], (1 - BOX_TRIM) * reached[-1]])
    return float(values[order[low]]), float(values[order[min(int(high), len(values) - 1)]])
