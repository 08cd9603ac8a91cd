"""Errors of rendered depth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.evaluation.metrics import Skipped, ViewMetric, ViewPrediction, mean
from fastsplat_contract.errors import InvalidInputError


def depth_error(
    rendered: NDArray[np.floating], truth: NDArray[np.floating], valid: NDArray[np.bool_] | None = None
) -> float | None:
    """Mean of |z − z*| / z* over the pixels of [H, W] that have a true camera z*; one without a rendered depth counts
    as 1. 0 in either map means that there is none. None where no pixel has a truth.

    Raises:
        InvalidInputError: shapes that differ.
    """
    if rendered.shape != truth.shape:
        raise InvalidInputError(f"a depth map of shape {rendered.shape} against {truth.shape}", field="rendered")
    known = np.isfinite(truth) & (truth > 0)
    if valid is not None:
        known &= valid
    if not known.any():
        return None
    z, true_z = rendered[known].astype(np.float64), truth[known].astype(np.float64)
    there = np.isfinite(z) & (z > 0)
    return float((np.where(there, np.abs(z - true_z), true_z) / true_z).mean())


def view_depth_error(view: ViewPrediction) -> float | Skipped:
    """The error of the view's expected depth."""
    if view.truth.depth is None:
        return Skipped("the view has no depth map")
    if view.depth is None:
        return Skipped("the view has no pose")
    error = depth_error(view.depth, view.truth.depth, view.truth.valid)
    return Skipped("no pixel that counts has a true depth") if error is None else error


DEPTH_ERROR = ViewMetric(
    name="depth_error",
    description="mean of |z - z*| / z* of the expected depth (abs rel of Eigen et al. 2014), a pixel without a "
    "rendered depth counting as 1; mean over views",
    measure=view_depth_error,
    combine=mean,
)
