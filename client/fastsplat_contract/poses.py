"""Places, directions and rotations, as they stand on the wire and as matrices.

The rotations are ours and not scipy's, which the client does not install.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.wire import Request, checked, travels

F64 = NDArray[np.float64]

_UNIT_TOLERANCE = 1e-3


@travels(request=True)
class Vector3(NamedTuple):
    """Scene units (meters when the scene's scale is METRIC)."""

    x: float
    y: float
    z: float


@travels(request=True)
class Quaternion(NamedTuple):
    """A rotation of unit length (refused if it is off by more than 0.001); mind the order x y z w."""

    x: float
    y: float
    z: float
    w: float


def unit_quaternion(values: Quaternion) -> Quaternion:
    """`values` x y z w, of length 1 to the last digit.

    Raises:
        InvalidInputError: not of unit length.
    """
    norm = math.hypot(*values)
    if not abs(norm - 1.0) <= _UNIT_TOLERANCE:  # also true of NaN
        raise InvalidInputError(
            f"orientation x y z w = {tuple(values)} has length {norm:.6g}",
            field="orientation",
            limit=f"length 1 ± {_UNIT_TOLERANCE}",
            hint="Send a unit quaternion; mind the order x y z w.",
        )
    return Quaternion(*(value / norm for value in values))


Orientation = Annotated[Quaternion, AfterValidator(checked(unit_quaternion))]
"""A quaternion of unit length."""


@dataclass(frozen=True)
class Pose(Request):
    """Where something stands, or how it is moved."""

    position: Annotated[Vector3, Field(description="world frame")]
    orientation: Orientation

    def matrix(self) -> F64:
        """float64 [4, 4]: the rigid transform x' = R x + t."""
        return rigid(self.orientation, self.position)


def rigid(orientation: Quaternion, position: Vector3) -> F64:
    """float64 [4, 4] of a unit quaternion and a translation."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_of(*orientation)
    matrix[:3, 3] = position
    return matrix


def rotation_of(x: float, y: float, z: float, w: float) -> F64:
    """float64 [3, 3] of a unit quaternion."""
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_of(rotation: F64) -> Quaternion:
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
    return Quaternion(*(q if q[3] >= 0 else -q).tolist())


def vector3(values: F64) -> Vector3:
    """The three numbers of an array [3]."""
    x, y, z = (float(value) for value in values)
    return Vector3(x, y, z)
