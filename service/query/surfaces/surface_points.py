"""A scene's surfaces as points: the depth of its cameras, back-projected, thinned, checked by the other views."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.query.surfaces.surface_views import (
    SurfaceSamples,
    SurfaceView,
    back_projected,
    observed,
    reliable,
)
from fastsplat.service.scene.artefact.scene import F32
from fastsplat_contract.errors import LimitExceededError

MAX_SURFACE_POINTS = 1_000_000
"""Points of a point cloud; without a cell that was asked for, cells are as wide as that needs."""

BAND = 3.0
"""Cells within which two views show the same surface."""

_FINEST = 2.0
"""Pixels of the views that one cell is as wide as, by default."""
_COARSER = 1.4
REACH = 1 << 20
"""Cells on either side of the origin that a key holds."""


def surface_points(
    views: Sequence[SurfaceView], *, cell: float, most: int = MAX_SURFACE_POINTS, limit: str = ""
) -> tuple[SurfaceSamples, float]:
    """Points on surfaces, at most one a cell, and the width of a cell in scene units. Points that only one view sees,
    or that more views see through than see, are left out.

    Args:
        views: of the scene.
        cell: its width; 0: two pixels of the views at the median depth, or wider, so that `most` is enough.
        most: points.
        limit: how an error names the limit, if not by `most`.

    Raises:
        LimitExceededError: more than `most` points, with a cell that was asked for.
        CancelledError: see `service.common.cancellation`.
    """
    width = cell or pixel_width(views) * _FINEST
    means = thinned([_thinned_view(view, width) for view in views], width)
    while len(means) > most:
        if cell:
            raise LimitExceededError(
                f"{len(means)} points, {cell:g} apart",
                field="cell",
                limit=limit or f"{most} points",
                hint="Ask for a larger cell.",
            )
        check_cancelled()
        width *= _COARSER
        means = thinned([means], width)
    samples = observed(means, views, BAND * width)
    return samples.where(reliable(samples, len(views))), width


def pixel_width(views: Sequence[SurfaceView]) -> float:
    """The median width of a pixel on the surfaces, scene units; 1 where there is none."""
    widths = [view.depth[view.depth > 0] / view.posed.camera.fx for view in views]
    every = np.concatenate(widths) if widths else np.zeros(0)
    return float(np.median(every)) if len(every) else 1.0


def thinned(points: Sequence[F32], cell: float) -> F32:
    """float32 [K, 3]: the mean of the points in each cell, in the order of the cells. Points more than 2²⁰ cells from
    the origin are left out."""
    every = np.concatenate(points) if points else np.zeros((0, 3), np.float32)
    keys, inside = cell_keys(every, cell)
    every = every[inside]
    _, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
    sums = [np.bincount(inverse, every[:, axis], len(counts)) for axis in range(3)]
    return np.asarray(np.stack(sums, axis=1) / np.maximum(counts, 1)[:, None], np.float32)


def cell_keys(points: F32, cell: float) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """int64 [K]: a number for the cell of each point within reach, x slowest; and which of the [P, 3] points these are,
    bool [P]."""
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.floor(points.astype(np.float64) / cell)
    inside = np.asarray((np.abs(steps) < REACH - 8).all(axis=1))
    cells = steps[inside].astype(np.int64) + REACH
    return cells[:, 0] << 42 | cells[:, 1] << 21 | cells[:, 2], inside


def _thinned_view(view: SurfaceView, cell: float) -> F32:
    check_cancelled()
    return thinned([back_projected(view)], cell)
