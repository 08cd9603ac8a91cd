"""Estimates the up direction of a splat from the surfaces that its Gaussians lie in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.splat_import.bulk import F64, Bulk, quantiles
from fastsplat_contract.jobs.operations import UpAxis

_SAMPLE = 100_000
_DIRECTIONS = 1_500
_ALIGNED = float(np.cos(np.radians(10)))
_NEAR = float(np.cos(np.radians(20)))
_FLAT = 0.5
_LARGE_SHARE = 0.95
_REACH = 3.0  # radii of the bulk within which surfaces count
_PEAKS = 4
_SLABS = 64
_CUSTOMARY = np.array([[0.0, 0, 1], [0, -1, 0], [0, 1, 0]])
"""Usual up axes: +z (nerfstudio), −y (COLMAP, 3DGS: first camera), +y (viewers)."""
_CUSTOM_WEIGHT = 1.0


def axis_vector(axis: UpAxis) -> F64:
    """Turns an axis name into a unit vector, float64 [3]."""
    vector = np.zeros(3)
    vector["xyz".index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    return vector


def estimate_up(gaussians: Gaussians, bulk: Bulk) -> F64:
    """Estimates the unit vector that points up, float64 [3].

    The shortest axes of flat Gaussians, weighted by opacity and area, peak at the normals of floor, table and walls.
    The best peak has a high weight, more matter above its densest slab than below, and is near to a usual up axis.
    Rooms whose ceiling is better seen come out upside down, so users may state the axis.
    """
    near = np.linalg.norm(gaussians.means - bulk.center, axis=1) < _REACH * bulk.radius
    rows = np.flatnonzero(near & (bulk.weights > 0))
    if len(rows) > _SAMPLE:
        rows = np.random.default_rng(0).choice(rows, _SAMPLE, replace=False)
    scales = np.exp(np.sort(gaussians.log_scales[rows].astype(np.float64), axis=1))
    rows, scales = rows[flat := scales[:, 0] < _FLAT * scales[:, 1]], scales[flat]
    if not len(rows):
        return np.array([0.0, 0.0, 1.0])
    areas = scales[:, 1] * scales[:, 2]
    weights = bulk.weights[rows] * np.minimum(areas, np.quantile(areas, _LARGE_SHARE))
    normals = _normals(gaussians, rows)
    heights = gaussians.means.astype(np.float64)
    best, up = -1.0, np.array([0.0, 0.0, 1.0])
    for peak, vote in _peaks(normals, weights):
        aligned = np.abs(normals @ peak) > _NEAR
        slab = _densest(heights[rows[aligned]] @ peak, weights[aligned])
        for sign in (1.0, -1.0):
            along = sign * (heights @ peak - slab)
            thick = bulk.radius / 10
            above, below = (float(bulk.weights[near & side].sum()) for side in (along > thick, along < -thick))
            share = above / max(above + below, 1e-12)
            custom = max(0.0, float((_CUSTOMARY @ (sign * peak)).max()))
            score = vote * share * (1 + _CUSTOM_WEIGHT * custom)
            if score > best:
                best, up = score, sign * peak
    return up


def _peaks(normals: F64, weights: F64) -> list[tuple[F64, float]]:
    """Finds the most frequent normals, up to sign, and their weights."""
    index = np.arange(_DIRECTIONS) + 0.5  # half a Fibonacci sphere
    polar, azimuth = np.arccos(1 - index / _DIRECTIONS), np.pi * (1 + 5**0.5) * index
    directions = np.stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], axis=1)
    votes = np.array([weights[np.abs(normals @ direction) > _ALIGNED].sum() for direction in directions])
    peaks = []
    for _ in range(_PEAKS):
        top = int(votes.argmax())
        if votes[top] <= 0:
            break
        own = np.abs(normals @ directions[top]) > _NEAR
        spread = (normals[own] * weights[own, None]).T @ normals[own]
        axis = np.linalg.eigh(spread)[1][:, 2]  # principal direction of the peak's normals
        peaks.append((axis, float(votes[top])))
        votes[np.abs(directions @ directions[top]) > np.cos(np.radians(30))] = 0
    return peaks


def _densest(heights: F64, weights: F64) -> float:
    """Finds the height of the slab with most weight."""
    low, high = quantiles(heights, weights, [0.02, 0.98])
    if high <= low:
        return float(low)
    sums, edges = np.histogram(heights, bins=_SLABS, range=(float(low), float(high)), weights=weights)
    top = int(sums.argmax())
    return float(edges[top] + edges[top + 1]) / 2


def _normals(gaussians: Gaussians, rows: NDArray[np.intp]) -> F64:
    """Shortest axis of each Gaussian in the world, float64 [K, 3]."""
    w, x, y, z = (gaussians.quats[rows] / np.linalg.norm(gaussians.quats[rows], axis=1, keepdims=True)).T.astype(float)
    columns = (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )
    axes = np.stack([np.stack(column, axis=1) for column in columns], axis=1)
    shortest = gaussians.log_scales[rows].argmin(axis=1)
    return np.asarray(axes[np.arange(len(rows)), shortest])
