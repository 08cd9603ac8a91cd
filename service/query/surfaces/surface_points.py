"""Surface points of a scene: back-projected depth, thinned and cross-checked between views."""

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
"""Most points of a point cloud; default cells widen until they suffice."""

BAND = 3.0
"""Depth difference in cells within which two views show the same surface."""

_FINEST = 2.0
"""Default cell width in pixels of the views."""
_COARSER = 1.4
REACH = 1 << 20
"""Cells on either side of the origin that a key can hold."""


def surface_points(
    views: Sequence[SurfaceView], *, cell: float, most: int = MAX_SURFACE_POINTS, limit: str = ""
) -> tuple[SurfaceSamples, float]:
    """Samples surfaces at most once per cell; returns the points and the cell width.

    Points that only one view sees, or that more views see through than see, are left out. The default width (`cell` 0)
    is two pixels at the median depth, or wider so that `most` points suffice; with an explicit one LimitExceededError
    is raised for more, with `limit` as the bound's name. Cancellable."""
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
    """Median width of a pixel on the surfaces, scene units; 1 if there is none."""
    widths = [view.depth[view.depth > 0] / view.posed.camera.fx for view in views]
    every = np.concatenate(widths) if widths else np.zeros(0)
    return float(np.median(every)) if len(every) else 1.0


def thinned(points: Sequence[F32], cell: float) -> F32:
    """Averages the points in each cell, float32 [K, 3]; drops those beyond 2²⁰ cells."""
    every = np.concatenate(points) if points else np.zeros((0, 3), np.float32)
    keys, inside = cell_keys(every, cell)
    every = every[inside]
    _, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
    sums = [np.bincount(inverse, every[:, axis], len(counts)) for axis in range(3)]
    return np.asarray(np.stack(sums, axis=1) / np.maximum(counts, 1)[:, None], np.float32)


def cell_keys(points: F32, cell: float) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Cell keys [K] (x slowest) of points within reach, and their mask [P]."""
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.floor(points.astype(np.float64) / cell)
    inside = np.asarray((np.abs(steps) < REACH - 8).all(axis=1))
    cells = steps[inside].astype(np.int64) + REACH
    return cells[:, 0] << 42 | cells[:, 1] << 21 | cells[:, 2], inside


def _thinned_view(view: SurfaceView, cell: float) -> F32:
    check_cancelled()
    return thinned([back_projected(view)], cell)
