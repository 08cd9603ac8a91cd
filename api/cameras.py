"""Poses of both wire formats to `PosedCamera` and back: one place for frames, quaternions and their checks."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from fastsplat.service.calls.types import Quaternion
from fastsplat.service.common.camera import Camera, PosedCamera
from fastsplat.service.common.errors import InvalidInputError
from fastsplat.service.common.poses import quaternion_of, rotation_of

Convention = Literal["OPENCV", "OPENGL"]
"""Camera axes: OpenCV is x right, y down, z forward; OpenGL (nerfstudio, Blender) is x right, y up, z backward."""

WORLD = "world"
"""The only frame the service knows: that of the scene."""

_UNIT_TOLERANCE = 1e-3
_OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def posed_camera(
    camera: Camera,
    position: tuple[float, float, float],
    orientation: Quaternion,
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
    pose = np.eye(4)
    pose[:3, :3] = rotation_of(*unit_quaternion(orientation, field=f"{field}.orientation"))
    pose[:3, 3] = position
    return PosedCamera(camera, pose @ _OPENCV_FROM_OPENGL if convention == "OPENGL" else pose)


def unit_quaternion(values: Quaternion, *, field: str) -> Quaternion:
    """`values` x y z w, of length 1 to the last digit.

    Raises:
        InvalidInputError: not of unit length.
    """
    norm = math.hypot(*values)
    if not abs(norm - 1.0) <= _UNIT_TOLERANCE:  # also true of NaN
        raise InvalidInputError(
            f"orientation x y z w = {values} has length {norm:.6g}",
            field=field,
            limit=f"length 1 ± {_UNIT_TOLERANCE}",
            hint="Send a unit quaternion; mind the order x y z w.",
        )
    x, y, z, w = (value / norm for value in values)
    return x, y, z, w


def orientation_of(posed: PosedCamera) -> Quaternion:
    """The pose's rotation as a unit quaternion x y z w with w ≥ 0."""
    return quaternion_of(posed.world_from_camera[:3, :3])


def position_of(posed: PosedCamera) -> tuple[float, float, float]:
    """The camera's centre in the world frame, scene units."""
    x, y, z = posed.world_from_camera[:3, 3].tolist()
    return x, y, z
