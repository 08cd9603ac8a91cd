"""Places, directions and rotations, as they stand on the wire and as matrices.

The rotations are ours and not scipy's, which the client does not install.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, Field

from fastsplat_contract.codec.wire import Request, Response, checked, travels
from fastsplat_contract.errors import InvalidInputError

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
        """float64 [4, 4]: the rigid transform x' = R x + t.

        Examples:
            >>> half_turn = Pose(Vector3(1.0, 0.0, 0.0), Quaternion(0.0, 0.0, 1.0, 0.0))
            >>> half_turn.matrix() @ [1, 2, 3, 1]
            array([ 0., -2.,  3.,  1.])
        """
        return rigid(self.orientation, self.position)


@dataclass(frozen=True)
class Box(Response):
    """An oriented box, as in vision_msgs/BoundingBox3D."""

    center: Annotated[Pose, Field(description="of the box's middle; orientation rotates box axes into world axes")]
    size: Annotated[Vector3, Field(description="whole edge lengths along the box's axes, scene units")]


def rigid(orientation: Quaternion, position: Vector3) -> F64:
    """float64 [4, 4] of a unit quaternion and a translation."""
    x, y, z, w = orientation
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), position[0]],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), position[1]],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), position[2]],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def look_at(position: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> F64:
    """float64 [4, 4], world_from_camera, OpenCV axes: a camera at `position` that looks at `target`, upright by `up`.

    Args:
        position, target: [3], two places.
        up: [3], of any length; straight up or down any side will do.
    """
    forward = np.subtract(target, position, dtype=np.float64)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, np.asarray(up, dtype=np.float64))
    if np.linalg.norm(right) < 1e-6:
        right = np.cross(forward, np.eye(3)[np.abs(forward).argmin()])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = position
    return pose


def pose_of(matrix: F64) -> Pose:
    """Of a rigid transform, float64 [4, 4]."""
    return Pose(vector3(matrix[:3, 3]), quaternion_of(matrix[:3, :3]))


def quaternion_of(rotation: F64) -> Quaternion:
    """x y z w with w ≥ 0 of a rotation matrix [3, 3] (Shepperd 1978, the best-conditioned branch)."""
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(rotation, dtype=np.float64).tolist()
    products = (  # 4 q qᵀ for q = (x, y, z, w)
        (1.0 + a - e - i, b + d, c + g, h - f),
        (b + d, 1.0 - a + e - i, f + h, c - g),
        (c + g, f + h, 1.0 - a - e + i, d - b),
        (h - f, c - g, d - b, 1.0 + a + e + i),
    )
    best = max(range(4), key=lambda row: products[row][row])
    length = math.copysign(math.hypot(*products[best]), products[best][3])
    return Quaternion(*(value / length for value in products[best]))


def vector3(values: F64) -> Vector3:
    """The three numbers of an array [3]."""
    return Vector3(*np.asarray(values, dtype=np.float64).tolist())
