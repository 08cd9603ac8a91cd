"""Visible Gaussians of a scene, their surface areas and grouping."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.logistic import logistic
from fastsplat.service.scene.artefact.scene import F32, Gaussians

F64 = NDArray[np.float64]

MIN_OPACITY = 0.05
"""Least opacity of a visible Gaussian."""


def solid_rows(gaussians: Gaussians) -> NDArray[np.int64]:
    """Rows of visible Gaussians (opaque enough and finite), int64 [K], ascending."""
    areas = masses(gaussians.log_scales, gaussians.logit_opacities)
    solid = gaussians.logit_opacities >= np.log(MIN_OPACITY / (1 - MIN_OPACITY))
    return np.flatnonzero(solid & np.isfinite(gaussians.means).all(axis=1) & np.isfinite(areas))


def grouped_rows(groups: NDArray[np.int32], rows: NDArray[np.int64]) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """Yields each group above 0 with its rows, both ascending."""
    inside = rows[groups[rows] > 0]
    ordered = inside[groups[inside].argsort(kind="stable")]
    numbers, starts = np.unique(groups[ordered], return_index=True)
    if len(numbers):
        yield from zip(numbers.tolist(), np.split(ordered, starts[1:]), strict=True)


def masses(log_scales: F32, logit_opacities: F32) -> F64:
    """Surface weight of each Gaussian, float64 [G]: opacity × the two larger standard deviations."""
    logs = log_scales.astype(np.float64)
    area = np.exp(logs.sum(axis=1) - logs.min(axis=1))
    return np.asarray(np.maximum(area * logistic(logit_opacities), np.finfo(np.float64).tiny))
