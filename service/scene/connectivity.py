"""Connected components of Gaussians."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array  # type: ignore[import-untyped]
from scipy.sparse.csgraph import connected_components  # type: ignore[import-untyped]
from scipy.spatial import cKDTree  # type: ignore[import-untyped]
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]

from fastsplat.service.scene.types import Gaussians

F64 = NDArray[np.float64]

_NEIGHBORS = 8
_REACH = 1.0
_WIDEST = 4.0
_SPACINGS = 2.0
_CELL = 0.5
_CELLS = 1 << 20
_CHUNK = 1 << 16


def components(gaussians: Gaussians, members: NDArray[np.int64]) -> NDArray[np.int32]:
    """int32 [K], the component of each of the Gaussians `members` [K], 0 ≤ component.

    Those within a cell of half the usual standard deviation are one; the widest stands for them, so that a dense clump
    has neighbors other than its own. Each of these is compared with its eight nearest: two touch where their centers
    are no further apart than the sum of their standard deviations along the line between them, or than twice the usual
    distance to the nearest neighbor. Standard deviations count up to four times the usual largest one, so that no
    giant bridges two objects. Work and memory are linear in K but for sorting and the tree.
    """
    if not len(members):
        return np.zeros(0, dtype=np.int32)
    scales = np.exp(gaussians.log_scales[members].astype(np.float64))
    usual = float(np.median(scales.max(axis=1)))
    np.minimum(scales, _WIDEST * usual, out=scales)
    cell, widest = _cells(gaussians.means[members].astype(np.float64), scales.max(axis=1), _CELL * usual)
    return _joined(
        gaussians.means[members[widest]].astype(np.float64),
        scales[widest],
        _rotations(gaussians.quats[members[widest]]),
    )[cell]


def _cells(means: F64, widths: F64, size: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which occupied cell each of the points [K, 3] is in, and the widest point of each cell."""
    offsets = means - means.min(axis=0)
    size = max(size, float(offsets.max()) / _CELLS, np.finfo(np.float64).tiny)
    x, y, z = (offsets / size).astype(np.int64).T
    keys = (x << 42) | (y << 21) | z
    order = np.lexsort((-widths, keys))
    first = np.flatnonzero(np.diff(keys[order], prepend=-1))
    cell = np.empty(len(keys), dtype=np.int64)
    cell[order] = np.repeat(np.arange(len(first)), np.diff(first, append=len(keys)))
    return cell, order[first]


def _joined(means: F64, scales: F64, turns: F64) -> NDArray[np.int32]:
    """int32 [K] components of K Gaussians at different places."""
    count = len(means)
    if count < 2:
        return np.zeros(count, dtype=np.int32)
    tree = cKDTree(means)
    spacing = _usual_spacing(tree, means)
    edges: list[NDArray[np.int64]] = []
    for start in range(0, count, _CHUNK):
        rows = np.arange(start, min(start + _CHUNK, count))
        distance, near = tree.query(means[rows], k=min(_NEIGHBORS + 1, count))
        pairs = np.stack([np.repeat(rows, near.shape[1]), near.ravel()])
        distance = distance.ravel()
        other = pairs[0] != pairs[1]
        pairs, distance = pairs[:, other], distance[other]
        towards = (means[pairs[1]] - means[pairs[0]]) / np.maximum(distance, np.finfo(np.float64).tiny)[:, None]
        reach = sum(_deviation(scales[end], turns[end], towards) for end in pairs)
        edges.append(pairs[:, distance <= np.maximum(_REACH * reach, _SPACINGS * spacing)])
    left, right = np.concatenate(edges, axis=1)
    graph = coo_array((np.ones(len(left), dtype=np.bool_), (left, right)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int32)


def _usual_spacing(tree: cKDTree, means: F64) -> float:
    """Median distance to the nearest neighbor, of at most 4,096 points."""
    sample = means[:: max(1, len(means) // 4096)]
    return float(np.median(tree.query(sample, k=2)[0][:, 1]))


def _deviation(scales: F64, turns: F64, towards: F64) -> F64:
    """[P]: √(uᵀ Σ u) along unit vectors u [P, 3]."""
    return np.asarray(np.linalg.norm(np.einsum("pij,pi->pj", turns, towards) * scales, axis=1))


def _rotations(quats: NDArray[np.float32]) -> F64:
    """[K, 3, 3], world-from-Gaussian; a quaternion of length 0 counts as no rotation."""
    usable = quats.astype(np.float64)[:, [1, 2, 3, 0]]
    usable[~(np.linalg.norm(usable, axis=1) > 0)] = (0.0, 0.0, 0.0, 1.0)
    return np.asarray(Rotation.from_quat(usable).as_matrix())
