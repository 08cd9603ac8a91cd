"""Z-order of points: sorts rows so that neighbors in space are neighbors in memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_BITS = 21  # 3 × 21 = 63 bits fit an unsigned 64-bit key


def morton_order(points: NDArray[np.floating]) -> NDArray[np.int64]:
    """Returns the stable row order of `points` [G, 3] along their bounding box's Z-curve.

    The box has 2²¹ cells a side; x is the most significant bit of each triple.
    """
    assert points.ndim == 2 and points.shape[1] == 3
    if len(points) == 0:
        return np.zeros(0, np.int64)
    low = points.min(axis=0).astype(np.float64)
    side = max(float((points.max(axis=0) - low).max()), np.finfo(np.float64).tiny)
    cells = np.minimum((points.astype(np.float64) - low) / side * 2**_BITS, 2**_BITS - 1).astype(np.uint64)
    keys = _spread(cells[:, 0]) << np.uint64(2) | _spread(cells[:, 1]) << np.uint64(1) | _spread(cells[:, 2])
    return np.argsort(keys, kind="stable")


def _spread(value: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Inserts two zero bits before each of the low 21 bits."""
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        value = (value | value << np.uint64(shift)) & np.uint64(mask)
    return value
