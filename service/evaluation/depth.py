"""How far rendered depth is from the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat_contract.errors import InvalidInputError


@dataclass(frozen=True)
class DepthErrors:
    """Of one view.

    Attributes:
        abs_rel: mean of |z − z*| / z* over pixels with a true depth; a pixel without a rendered depth counts as 1.
        median_abs: median of |z − z*| over pixels that have both, scene units; NaN when none has.
        coverage: share of the pixels with a true depth that have a rendered one.
    """

    abs_rel: float
    median_abs: float
    coverage: float


def depth_errors(
    rendered: NDArray[np.floating], truth: NDArray[np.floating], valid: NDArray[np.bool_] | None = None
) -> DepthErrors | None:
    """Camera z [H, W] against the true one; 0 in either means that there is none. None where no pixel has a truth.

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
    return DepthErrors(float((error / true_z).mean()), median, float(there.mean()))
