"""Isolation of Gaussians, which separates floaters from surfaces."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from fastsplat.service.scene.artefact.scene import F32, Gaussians

_NEIGHBORS = 8


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
