"""Neighborhoods of Gaussians: connected components, and isolation, which separates floaters from surfaces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from fastsplat.service.scene.artefact.scene import F32, Gaussians

F64 = NDArray[np.float64]

_NEIGHBORS = 8
_REACH = 1.0
_WIDEST = 4.0
_SPACINGS = 2.0
_CELL = 0.5
_CELLS = 1 << 20
_CHUNK = 1 << 16
_SLACK = 1.001  # float32 quaternions stretch by less


def components(gaussians: Gaussians, members: NDArray[np.int64]) -> NDArray[np.int32]:
    """Labels connected components of the Gaussians `members` [K]; int32 [K], from 0.

    Gaussians within a cell of half the usual standard deviation are merged and represented by the widest, so that a
    dense clump has neighbors outside itself. Each representative is compared with its eight nearest: two touch if their
    centers are no further apart than the sum of their standard deviations along the line between them, or than twice
    the usual nearest-neighbor distance. Standard deviations are capped at four times the usual largest one, so that no
    giant bridges two objects. Work and memory are linear in K except for sorting and the tree.
    """
    if not len(members):
        return np.zeros(0, dtype=np.int32)
    scales = np.exp(gaussians.log_scales[members].astype(np.float64))
    usual = float(np.median(scales.max(axis=1)))
    np.minimum(scales, _WIDEST * usual, out=scales)
    cell, widest = _cells(gaussians.means[members].astype(np.float64), scales.max(axis=1), _CELL * usual)
    return _joined(
        gaussians.means[members[widest]].astype(np.float64), scales[widest], gaussians.quats[members[widest]]
    )[cell]


def _cells(means: F64, widths: F64, size: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Returns the occupied cell of each point [K, 3] and each cell's widest point."""
    offsets = means - means.min(axis=0)
    size = max(size, float(offsets.max()) / _CELLS, np.finfo(np.float64).tiny)
    x, y, z = (offsets / size).astype(np.int64).T
    keys = (x << 42) | (y << 21) | z
    order = np.lexsort((-widths, keys))
    first = np.flatnonzero(np.diff(keys[order], prepend=-1))
    cell = np.empty(len(keys), dtype=np.int64)
    cell[order] = np.repeat(np.arange(len(first)), np.diff(first, append=len(keys)))
    return cell, order[first]


def _joined(means: F64, scales: F64, quats: NDArray[np.float32]) -> NDArray[np.int32]:
    """Labels components of K Gaussians at distinct places, int32 [K]; tests few shapes."""
    count = len(means)
    if count < 2:
        return np.zeros(count, dtype=np.int32)
    left, right, distance = _neighbor_pairs(means)
    sure = distance <= _SPACINGS * _usual_spacing(count, left, distance)
    component = _united(count, left[sure], right[sure])
    widths = scales.max(axis=1)
    near = ~sure & (distance <= _REACH * _SLACK * (widths[left] + widths[right]))
    # Shapes are compared only where two are not joined yet and neither surely touch nor are surely apart.
    doubtful = np.flatnonzero(near)[component[left[near]] != component[right[near]]]
    if not len(doubtful):
        return component
    left, right, distance = left[doubtful], right[doubtful], distance[doubtful]
    ends, place = np.unique(np.concatenate([left, right]), return_inverse=True)
    turns, end_scales = rotations_of(quats[ends]), scales[ends]
    towards = (means[right] - means[left]) / np.maximum(distance, np.finfo(np.float64).tiny)[:, None]
    reach = sum(_deviation(end_scales[side], turns[side], towards) for side in np.split(place, 2))
    touch = distance <= _REACH * reach
    joined = _united(int(component.max()) + 1, component[left[touch]], component[right[touch]])
    return joined[component]


def _neighbor_pairs(means: F64) -> tuple[NDArray[np.int32], NDArray[np.int32], F64]:
    """Indices (ascending) and distances of points [K, 3] and their eight nearest neighbors."""
    count, tree = len(means), cKDTree(means)
    firsts, seconds, distances = [], [], []
    for start in range(0, count, _CHUNK):
        rows = np.arange(start, min(start + _CHUNK, count), dtype=np.int32)
        distance, near = tree.query(means[rows], k=min(_NEIGHBORS + 1, count))
        left, right = np.repeat(rows, near.shape[1]), near.astype(np.int32).ravel()
        distinct = left != right
        firsts.append(left[distinct])
        seconds.append(right[distinct])
        distances.append(distance.ravel()[distinct])
    return np.concatenate(firsts), np.concatenate(seconds), np.concatenate(distances)


def _usual_spacing(count: int, left: NDArray[np.int32], distance: F64) -> float:
    """Returns the median nearest-neighbor distance over at most 4,096 points."""
    sample = np.arange(0, count, max(1, count // 4096), dtype=np.int32)
    return float(np.median(distance[np.searchsorted(left, sample)]))


def _united(count: int, left: NDArray[np.integer], right: NDArray[np.integer]) -> NDArray[np.int32]:
    """Labels components of a graph, int32 [count], numbered by their lowest nodes."""
    graph = coo_array((np.ones(len(left), dtype=np.bool_), (left, right)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int32)


def _deviation(scales: F64, turns: F64, towards: F64) -> F64:
    """Returns √(uᵀ Σ u) [P] along unit vectors u [P, 3]."""
    return np.asarray(np.linalg.norm(np.einsum("pij,pi->pj", turns, towards) * scales, axis=1))


def rotations_of(quats: NDArray[np.float32]) -> F64:
    """Converts quaternions w x y z [K, 4] to rotations, float64 [K, 3, 3]; zero ones to identity."""
    usable = quats.astype(np.float64)[:, [1, 2, 3, 0]]
    usable[~(np.linalg.norm(usable, axis=1) > 0)] = (0.0, 0.0, 0.0, 1.0)
    return np.asarray(Rotation.from_quat(usable).as_matrix())


def isolation(gaussians: Gaussians) -> F32:
    """Returns each Gaussian's distance to its eighth neighbor relative to the median, float32 [G].

    With fewer others the farthest counts. Infinite for a non-finite center, 0 for a single Gaussian.

    In six drawn rooms of 30,000 Gaussians each, 0.52 to 1.0 of the floaters' opacity had more than 4, and .01 to .02 of
    that on surfaces. Comparing with the neighbors' own spacing or with a Gaussian's size separated them far worse.
    """
    result = np.full(len(gaussians), np.inf, np.float32)
    finite = np.flatnonzero(np.isfinite(gaussians.means).all(axis=1))
    count = min(_NEIGHBORS, len(finite) - 1)
    if count < 1:
        result[finite] = 0
        return result
    centers = gaussians.means[finite]
    distance = cKDTree(centers).query(centers, k=[count + 1])[0][:, 0]
    result[finite] = distance / max(float(np.median(distance)), np.finfo(np.float32).tiny)
    return result
