"""Rotations as unit quaternions x y z w and as matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


def rotation_of(x: float, y: float, z: float, w: float) -> F64:
    """float64 [3, 3] of a unit quaternion."""
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_of(rotation: F64) -> tuple[float, float, float, float]:
    """x y z w with w ≥ 0 of a rotation matrix [3, 3] (Shepperd 1978, the best-conditioned branch)."""
    m = rotation
    trace = float(np.trace(m))
    squares = np.array([*(1.0 - trace + 2.0 * np.diag(m)), 1.0 + trace])  # 4x², 4y², 4z², 4w²
    best = int(np.argmax(squares))
    products = np.array(  # 4 q qᵀ for q = (x, y, z, w)
        [
            [squares[0], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[2, 1] - m[1, 2]],
            [m[0, 1] + m[1, 0], squares[1], m[1, 2] + m[2, 1], m[0, 2] - m[2, 0]],
            [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], squares[2], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], squares[3]],
        ]
    )
    q = products[best] / np.linalg.norm(products[best])
    x, y, z, w = (q if q[3] >= 0 else -q).tolist()
    return x, y, z, w
