"""Errors of rendered depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.evaluation.types import Skipped, ViewMetric, ViewPrediction, mean
from fastsplat_contract.errors import InvalidInputError


@dataclass(frozen=True)
class DepthErrors:
    """Depth errors of one view.

    Attributes:
        abs_rel: mean of |z − z*| / z* over pixels with a true depth; a pixel without a rendered depth counts as 1.
        median_rel: median of the same.
        median_abs: median of |z − z*| over pixels that have both, scene units; NaN when none has.
        coverage: share of the pixels with a true depth that have a rendered one.
    """

    abs_rel: float
    median_rel: float
    median_abs: float
    coverage: float


def depth_errors(
    rendered: NDArray[np.floating], truth: NDArray[np.floating], valid: NDArray[np.bool_] | None = None
) -> DepthErrors | None:
    """Errors of camera z [H, W] against the true one; 0 in either means that there is none. None where no pixel has a
    truth.

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
    error = np.where(there, np.abs(z - true_z), true_z)
    median = float(np.median(error[there])) if there.any() else float("nan")
    relative = error / true_z
    return DepthErrors(float(relative.mean()), float(np.median(relative)), median, float(there.mean()))


def view_depth_errors(view: ViewPrediction) -> DepthErrors | Skipped:
    """Errors of the view's expected depth."""
    if view.truth.depth is None:
        return Skipped("the view has no depth map")
    if view.depth is None:
        return Skipped("the view has no pose")
    errors = depth_errors(view.depth, view.truth.depth, view.truth.valid)
    return Skipped("no pixel that counts has a true depth") if errors is None else errors


DEPTH_ERROR = ViewMetric(
    name="depth_error",
    unit="",
    higher_is_better=False,
    description="mean of |z - z*| / z* of the expected depth (abs rel of Eigen et al. 2014), a pixel without a "
    "rendered depth counting as 1; mean over views",
    measure=view_depth_errors,
    combine=lambda errors: mean([each.abs_rel for each in errors]),
    headline=True,
)
DEPTH_MEDIAN = ViewMetric(
    name="depth_median",
    unit="",
    higher_is_better=False,
    description="median of |z - z*| / z* of the expected depth, a pixel without a rendered depth counting as 1; mean "
    "over views",
    measure=view_depth_errors,
    combine=lambda errors: mean([each.median_rel for each in errors]),
)
DEPTH_MEDIAN_ABS = ViewMetric(
    name="depth_median_abs",
    unit="scene units",
    higher_is_better=False,
    description="median of |z - z*| over pixels with a rendered and a true depth; mean over views",
    measure=view_depth_errors,
    combine=lambda errors: mean([each.median_abs for each in errors]),
    undefined="no test view has a rendered depth",
)
DEPTH_COVERAGE = ViewMetric(
    name="depth_coverage",
    unit="",
    higher_is_better=True,
    description="share of the pixels with a true depth that have a rendered one; mean over views",
    measure=view_depth_errors,
    combine=lambda errors: mean([each.coverage for each in errors]),
)
