"""How much of a place no photo shows: where something may be that nobody could find."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.query.things.absence import ALL_SEEN, UnseenSpace
from fastsplat.service.query.things.solid_gaussians import grouped_rows, solid_rows
from fastsplat.service.query.things.visibility import SightLines, spread_views
from fastsplat.service.scene.types import Scene, SurfaceKind

F64 = NDArray[np.float64]

_CELLS = 40
"""Along the longest side of the place."""
_MAX_POINTS = 65_536
_MAX_HULL_POINTS = 2_000
_TRIM = 0.01
"""Share of the points beyond either end of each axis that do not make the place larger."""
_MOST_NAMED = 2
_BOUNDARIES: tuple[SurfaceKind, ...] = ("floor", "ceiling", "wall")
"""What is behind these is outside of the place."""


def surface_kind(name: str, kind: SurfaceKind = "") -> SurfaceKind:
    """What a thing of a name and a kind, or a label, is taken for: walls that come with label maps are called so."""
    return kind or next((each for each in _BOUNDARIES if label_key(name) == each), "")


def unseen_space(scene: Scene, owner: NDArray[np.int32], surfaces: Mapping[int, SurfaceKind]) -> UnseenSpace:
    """How much of the space between a scene's things is behind something in every photo that looks towards it.

    The place is the convex hull of the things' Gaussians, in cubes, 40 along its longest side. A cube is seen where a
    photo has its middle in the picture, no further behind the nearest opaque Gaussian of its cell and the cells around
    it than the cube is wide; it is unseen where photos have it in the picture and none sees it. Unseen cubes that
    mostly floors, ceilings and walls hide are outside of the place. Those that touch are a hollow; it counts where a
    ball as wide as half of the things are at most, along their longest side, fits into it. The cost is bounded: 64
    views, 65,536 Gaussians.

    Args:
        scene: its cameras and Gaussians.
        owner: int32 [G]: the thing or the label of each Gaussian, 0 for none.
        surfaces: of those, what surfaces are.
    """
    if not scene.cameras:
        return ALL_SEEN
    rows = solid_rows(scene.gaussians)
    rows = rows[scene.gaussians.logit_opacities[rows] > 0]
    rows = rows[:: -(-len(rows) // _MAX_POINTS) or 1]
    points, of = scene.gaussians.means[rows].astype(np.float64), owner[rows]
    place = _cubes(points[of > 0])
    if place is None:
        return ALL_SEEN
    grid, inside, width = place
    middles = grid[inside]
    seen = np.zeros(len(middles), np.bool_)
    hidden, outside = np.zeros((2, len(middles)), np.int64)
    behind = np.zeros(len(middles), np.int64)
    boundary = np.zeros(int(of.max(initial=0)) + 1, np.bool_)
    boundary[[each for each, kind in surfaces.items() if kind in _BOUNDARIES and each < len(boundary)]] = True
    for posed in spread_views(scene.cameras):
        sight = SightLines(posed, points)
        cell, depth, ahead = sight.cells(middles)
        visible = depth <= sight.nearest[cell] + width
        seen[ahead[visible]] = True
        hiding, by = ahead[~visible], of[sight.front[cell[~visible]]]
        hidden[hiding] += 1
        outside[hiding] += boundary[by]
        behind[hiding[~boundary[by]]] = by[~boundary[by]]
    unseen = ~seen & (hidden > 0) & (2 * outside <= hidden)
    hollow = np.zeros(inside.shape, np.bool_)
    hollow[inside] = unseen
    counted = _wide_enough(hollow, _usual_size(points, of, surfaces) / width)[inside]
    among = seen | unseen
    if not counted.any():
        return ALL_SEEN
    ids, counts = np.unique(behind[counted & (behind > 0)], return_counts=True)
    order = (-counts).argsort(kind="stable")[:_MOST_NAMED]
    return UnseenSpace(float(counted.sum() / among.sum()), tuple(ids[order].tolist()))


def _cubes(points: F64) -> tuple[F64, NDArray[np.bool_], float] | None:
    """The middles of cubes around points [K, 3], which of them are inside the points' convex hull, and how wide they
    are; None where the points have no volume."""
    if len(points) < 4:
        return None
    low, high = np.quantile(points, [_TRIM, 1 - _TRIM], axis=0)
    core = points[((points >= low) & (points <= high)).all(axis=1)]
    try:
        planes = ConvexHull(core[:: -(-len(core) // _MAX_HULL_POINTS) or 1]).equations
    except (QhullError, ValueError):
        return None
    width = float((high - low).max() / _CELLS)
    if not width:
        return None
    counts = np.maximum(np.ceil((high - low) / width), 1).astype(int)
    axes = [start + (np.arange(count) + 0.5) * width for start, count in zip(low, counts, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    inside = np.ones(grid.shape[:3], np.bool_)
    for a, b, c, d in planes:
        inside &= grid @ np.array([a, b, c]) + d <= 0
    return grid, inside, width


def _usual_size(points: F64, of: NDArray[np.int32], surfaces: Mapping[int, SurfaceKind]) -> float:
    """How long half of the things are at most, along the axis that they are longest; 0 without things."""
    sizes = [
        np.ptp(np.quantile(points[rows], [_TRIM, 1 - _TRIM], axis=0), axis=0).max()
        for each, rows in grouped_rows(of, np.arange(len(of)))
        if not surfaces.get(each)
    ]
    return float(np.median(sizes)) if sizes else 0.0


def _wide_enough(hollow: NDArray[np.bool_], diameter: float) -> NDArray[np.bool_]:
    """Of hollows, [X, Y, Z], those cubes whose hollow holds a ball of a diameter, in cubes."""
    from scipy import ndimage  # no other question needs it

    pieces, count = ndimage.label(hollow)
    within = ndimage.distance_transform_edt(np.pad(hollow, 1))[1:-1, 1:-1, 1:-1]
    widest = ndimage.maximum(within, pieces, np.arange(count + 1))
    return np.asarray(hollow & (2 * np.asarray(widest)[pieces] - 1 >= diameter))
