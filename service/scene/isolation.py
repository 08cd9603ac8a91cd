"""How far Gaussians are from others: what hangs in the air is far from all."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from fastsplat.service.scene.types import F32, Gaussians

_NEIGHBORS = 8


def isolation(gaussians: Gaussians) -> F32:
    """float32 [G]: how far the eighth nearest other center is from each Gaussian's own, in times of the scene's median;
    with fewer others the farthest of them. Infinite for a center that is not finite, 0 for one that is alone.

    In six drawn rooms of 30,000 Gaussians each, 0.52 to 1.0 of the opacity that hung in the air had more than 4, and
    .01 to .02 of that on surfaces. Comparing with the neighbors' own spacing, or with a Gaussian's size, told them
    apart far worse.
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
