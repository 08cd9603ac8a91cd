"""Poses of both wire formats to `PosedCamera` and back: one place for frames, quaternions and their checks."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from service.common.camera import Camera, PosedCamera
from service.common.errors import InvalidInputError

Convention = Literal["OPENCV", "OPENGL"]
"""Camera axes: OpenCV is x right, y down, z forward; OpenGL (nerfstudio, Blender) is x right, y up, z backward."""

WORLD = "world"
"""The only frame the service knows: that of the scene."""

_UNIT_TOLERANCE = 1e-3
_OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def posed_camera(
    camera: Camera,
    position: tuple[float, float, float],
    orientation: tuple[float, float, float, float],
    *,
    convention: Convention,
    frame_id: str,
    field: str,
) -> PosedCamera:
    """A free viewpoint.

    Args:
        camera: its intrinsics.
        position: the camera's centre x y z in the world frame, scene units.
        orientation: unit quaternion x y z w that rotates camera axes into world axes.
        convention: which camera axes `orientation` speaks of.
        frame_id: the frame of position and orientation; "" or "world".
        field: the input's name for error messages.

    Raises:
        InvalidInputError: a number is not finite, the quaternion is not of unit length, the frame is unknown.
    """
    if frame_id not in ("", WORLD):
        raise InvalidInputError(
            f"frame {frame_id[:80]!r} is unknown",
            field=f"{field}.frame_id",
            hint=f'Transform the pose into the scene\'s frame and say "{WORLD}".',
        )
    if not all(map(math.isfinite, position)):
        raise InvalidInputError(f"position {position} is not finite", field=f"{field}.position")
    norm = math.hypot(*orientation)
    if not abs(norm - 1.0) <= _UNIT_TOLERANCE:  # also true of NaN
        raise InvalidInputError(
            f"orientation x y z w = {orientation} has length {norm:.6g}",
            field=f"{field}.orientation",
            limit=f"length 1 ± {_UNIT_TOLERANCE}",
            hint="Send a unit quaternion; mind the order x y z w.",
        )
    pose = np.eye(4)
    pose[:3, :3] = _rotation(*(value / norm for value in orientation))
    pose[:3, 3] = position
    return PosedCamera(camera, pose @ _OPENCV_FROM_OPENGL if convention == "OPENGL" else pose)


def orientation_of(posed: PosedCamera) -> tuple[float, float, float, float]:
    """The pose's rotation as a unit quaternion x y z w with w ≥ 0 (Shepperd 1978, the best-conditioned branch)."""
    m = posed.world_from_camera[:3, :3]
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


def position_of(posed: PosedCamera) -> tuple[float, float, float]:
    """The camera's centre in the world frame, scene units."""
    x, y, z = posed.world_from_camera[:3, 3].tolist()
    return x, y, z


def _rotation(x: float, y: float, z: float, w: float) -> NDArray[np.float64]:
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
