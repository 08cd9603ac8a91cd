"""Voxel grids inside convex hulls, and their connected components."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from fastsplat_contract.geometry.poses import Vector3

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

_FINEST = 1 / 40
"""Least width of a cube, as a share of the longest side."""
_MAX_HULL_POINTS = 2_000
TRIM = 0.01
"""Share of points trimmed at either end of each axis."""


@dataclass(frozen=True)
class CubeGrid:
    """Cubes inside a convex hull."""

    thing_id: int  # whose hull; 0 for all together
    inside: Mask  # bool [X, Y, Z], which cubes are inside
    middles: F64  # float64 [K, 3], their middles, world frame
    width: float  # of a cube, scene units


@dataclass(frozen=True)
class Pieces:
    """Connected components of a grid's cubes."""

    numbers: NDArray[np.int64]  # int64 [K], of which piece each cube inside the hull is, from 1; 0 for none
    widths: F64  # float64 [P + 1], of the largest ball that fits into each piece, scene units; 0 first
    middles: tuple[Vector3, ...]  # P + 1 middles of these balls, world frame


def cube_grid(points: F64, thing_id: int, across: int = 0) -> CubeGrid | None:
    """Voxelizes the convex hull of points [K, 3]; None without volume.

    `across`: cubes along the shortest side; at most 40 along the longest side, as for 0."""
    if len(points) < 4:
        return None
    low, high = np.quantile(points, [TRIM, 1 - TRIM], axis=0)
    core = points[((points >= low) & (points <= high)).all(axis=1)]
    try:
        planes = ConvexHull(core[:: -(-len(core) // _MAX_HULL_POINTS) or 1]).equations
    except (QhullError, ValueError):
        return None
    size = high - low
    width = float(max(size.max() * _FINEST, size.min() / across if across else 0.0))
    if not width:
        return None
    counts = np.maximum(np.ceil(size / width), 1).astype(int)
    axes = [start + (np.arange(count) + 0.5) * width for start, count in zip(low, counts, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    inside = np.ones(grid.shape[:3], np.bool_)
    for a, b, c, d in planes:
        inside &= grid @ np.array([a, b, c]) + d <= 0
    return CubeGrid(thing_id, inside, grid[inside], width) if inside.any() else None


def most_around(grid: CubeGrid, marked: Mask) -> Mask:
    """Majority filter over the 3×3×3 neighborhoods inside the hull, bool [K]."""
    from scipy import ndimage

    whole = np.zeros((2, *grid.inside.shape))
    whole[0][grid.inside], whole[1] = marked, grid.inside
    share, there = (ndimage.uniform_filter(values, 3, mode="constant")[grid.inside] for values in whole)
    return np.asarray(2 * share > there)


def pieces_of(grid: CubeGrid, marked: Mask) -> Pieces:
    """Connected components of the marked cubes, bool [K], inside a grid's hull."""
    from scipy import ndimage  # no other question needs it

    whole = np.zeros(grid.inside.shape, np.bool_)
    whole[grid.inside] = marked
    numbers, count = ndimage.label(whole)
    within = ndimage.distance_transform_edt(np.pad(whole, 1))[1:-1, 1:-1, 1:-1][grid.inside]
    own = numbers[grid.inside].astype(np.int64)
    deepest = [0, *(int(np.where(own == number, within, 0).argmax()) for number in range(1, count + 1))]
    widths = (2 * within[deepest] - 1) * grid.width
    widths[0] = 0.0
    return Pieces(own, widths, tuple(Vector3(*grid.middles[row].tolist()) for row in deepest))
