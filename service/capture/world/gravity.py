"""Estimates the vertical of a capture from photo metadata, level cameras, floors and tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.captures import VerticalEstimate
from fastsplat.service.common.vertical import level_deviation, mean_up, vertical_of_poses
from fastsplat_contract.messages.scenes import VerticalSource

F64 = NDArray[np.float64]

_LEAST_PHOTOS = 3
_MOST_DISAGREEMENT_DEG = 12.0
_SENSOR_DEG = 0.5  # 1 σ shared by all photos of a device: its accelerometer sits askew
_MEAN_UP_DEG = 15.0
_LEAST_AGREEMENT = 0.5
_LEVEL_DEG = 0.3  # 1 σ of level floors and tables
_ONE_PLANE_DEG = 1.5  # 1 σ of a single plane, which may be a slope
_GATE_DEG = 25.0
_MOST_PLANES = 4
_LEAST_INLIERS = 40
_LEAST_SHARE = 0.05
_THICKNESS = 0.0015  # to either side of a plane, over the scene's extent
_LEAST_SHARPNESS = 0.55
"""Share of the points within three thicknesses; a slab through clutter has a third."""
_TRIPLES = 1_500
_MOST_POINTS = 4_000
_SEED = 0


@dataclass(frozen=True)
class Vertical:
    """An estimated vertical."""

    up: F64  # unit vector [3], world
    estimate: VerticalEstimate


def vertical_of_capture(world_from_camera: F64, points: F64, photo_ups: Sequence[F64]) -> Vertical | None:
    """Estimates the vertical from metadata, else level cameras, else the cameras' mean up.

    It is combined by inverse variances with level planes unless they are more than 3 σ apart; None without evidence.

    Args:
        world_from_camera: [N, 4, 4], OpenCV axes.
        points: [P, 3], world.
        photo_ups: unit vectors up of single photos, world.
    """
    first = _of_photos(photo_ups) or _of_cameras(world_from_camera)
    if first is None:
        return None
    planes = _of_planes(points, first)
    if planes is None:
        return first
    apart = _degrees(planes.up, first.up)
    deviations = np.array([first.estimate.deviation_deg, planes.estimate.deviation_deg])
    if apart > 3 * float(np.linalg.norm(deviations)):
        return first
    weights = 1 / deviations**2
    up = weights[0] * first.up + weights[1] * planes.up
    deviation = float(1 / np.sqrt(weights.sum()))
    best = first if weights[0] >= weights[1] else planes
    return Vertical(up / np.linalg.norm(up), VerticalEstimate(best.estimate.source, deviation))


def _of_photos(ups: Sequence[F64]) -> Vertical | None:
    """Averages the photos' directions without those that disagree with their median."""
    if len(ups) < _LEAST_PHOTOS:
        return None
    vectors = np.stack(ups)
    middle = np.median(vectors, axis=0)
    if np.linalg.norm(middle) < _LEAST_AGREEMENT:
        return None
    angles = np.array([_degrees(vector, middle) for vector in vectors])
    agreeing = vectors[angles <= _MOST_DISAGREEMENT_DEG]
    if len(agreeing) < max(_LEAST_PHOTOS, 0.6 * len(vectors)):
        return None
    up = agreeing.mean(axis=0)
    up /= np.linalg.norm(up)
    spread = np.sqrt(np.mean([_degrees(vector, up) ** 2 for vector in agreeing]))
    return _vertical(up, "metadata", float(np.hypot(spread / np.sqrt(len(agreeing)), _SENSOR_DEG)))


def _of_cameras(world_from_camera: F64) -> Vertical | None:
    up = vertical_of_poses(world_from_camera)
    if up is not None:
        return _vertical(up, "horizon", level_deviation(world_from_camera, up))
    up = mean_up(world_from_camera)
    return None if up is None else _vertical(up, "cameras", _MEAN_UP_DEG)


def _of_planes(points: F64, first: Vertical) -> Vertical | None:
    """Common normal of the largest nearly level planes, by sequential RANSAC and principal axes."""
    rng = np.random.default_rng(_SEED)
    low, high = np.percentile(points, [2, 98], axis=0) if len(points) else (np.zeros(3), np.zeros(3))
    left = points[((points >= low) & (points <= high)).all(axis=1)]
    if len(left) > _MOST_POINTS:
        left = left[rng.choice(len(left), _MOST_POINTS, replace=False)]
    least = max(_LEAST_INLIERS, _LEAST_SHARE * len(left))
    thickness = _THICKNESS * float(np.linalg.norm(high - low))
    gate = np.cos(np.radians(min(_GATE_DEG, max(5.0, 3 * first.estimate.deviation_deg))))
    normals, sizes = [], []
    for _ in range(_MOST_PLANES):
        if len(left) < least:
            break
        plane = _largest_plane(left, first.up, float(gate), thickness, rng)
        if plane is None:
            break
        normal, heights = plane
        inside, near = heights < thickness, heights < 3 * thickness
        if inside.sum() < least:
            break
        if inside.sum() >= _LEAST_SHARPNESS * near.sum():
            normals.append(normal)
            sizes.append(int(inside.sum()))
        left = left[~near]
    if not normals:
        return None
    weights = np.array(sizes, dtype=np.float64)
    up = weights @ np.stack(normals)
    up /= np.linalg.norm(up)
    if len(normals) == 1:
        return _vertical(up, "planes", _ONE_PLANE_DEG)
    angles = np.array([_degrees(normal, up) for normal in normals])
    spread = float(np.sqrt(weights @ angles**2 / weights.sum() / (len(normals) - 1)))
    return _vertical(up, "planes", float(np.hypot(spread, _LEVEL_DEG)))


def _largest_plane(
    points: F64, up: F64, gate: float, thickness: float, rng: np.random.Generator
) -> tuple[F64, F64] | None:
    """Finds the normal towards `up`, and each point's distance from the plane."""
    corners = points[rng.integers(0, len(points), (_TRIPLES, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    usable = (lengths > 0) & (np.abs(normals @ up) > gate * lengths)
    if not usable.any():
        return None
    normals, origins = normals[usable] / lengths[usable, None], corners[usable, 0]
    heights = np.abs(normals @ points.T - (normals * origins).sum(axis=1, keepdims=True))
    distances = heights[np.argmax((heights < thickness).sum(axis=1))]
    normal = up
    for _ in range(3):
        inside = points[distances < thickness]
        if len(inside) < 3:
            return None
        center = inside.mean(axis=0)
        normal = np.linalg.svd(inside - center, full_matrices=False)[2][2]
        normal = normal if normal @ up > 0 else -normal
        distances = np.abs((points - center) @ normal)
    return (normal, distances) if normal @ up > gate else None


def _vertical(up: F64, source: VerticalSource, deviation_deg: float) -> Vertical:
    return Vertical(np.asarray(up, dtype=np.float64), VerticalEstimate(source, deviation_deg))


def _degrees(first: F64, second: F64) -> float:
    cosine = first @ second / (np.linalg.norm(first) * np.linalg.norm(second))
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
