"""Pinhole cameras and poses. OpenCV axes (x right, y down, z forward); pixel centres at +0.5."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.errors import InvalidInputError


@dataclass(frozen=True)
class Camera:
    """Intrinsics of an undistorted image, in pixels of that image.

    A point (x, y, z) of the camera frame, z > 0, lands at (fx·x/z + cx, fy·y/z + cy), where the centre of the
    top-left pixel is (0.5, 0.5).
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise InvalidInputError(f"an image of {self.width}×{self.height} pixels", field="camera.width/height")
        values = (self.fx, self.fy, self.cx, self.cy)
        if not all(np.isfinite(values)) or self.fx <= 0 or self.fy <= 0:
            raise InvalidInputError(f"intrinsics fx, fy, cx, cy = {values}", field="camera.fx/fy/cx/cy")

    def scaled_to(self, width: int, height: int) -> Camera:
        """The same lens seen by an image of another size (the aspect may differ by rounding)."""
        sx, sy = width / self.width, height / self.height
        return Camera(width, height, self.fx * sx, self.fy * sy, self.cx * sx, self.cy * sy)


@dataclass(frozen=True)
class PosedCamera:
    """A camera and where it stands.

    Attributes:
        camera: intrinsics.
        world_from_camera: float64 [4, 4], rigid (rotation and translation, last row 0 0 0 1), scene units.
        name: the image's file name in the capture, or "" for a free viewpoint.
    """

    camera: Camera
    world_from_camera: NDArray[np.float64]
    name: str = ""

    def __post_init__(self) -> None:
        check_rigid(self.world_from_camera, field=f"pose of {self.name}" if self.name else "pose")

    def camera_from_world(self) -> NDArray[np.float64]:
        """float64 [4, 4]: the inverse pose, what the field calls a viewmat."""
        rotation, translation = self.world_from_camera[:3, :3], self.world_from_camera[:3, 3]
        inverse = np.eye(4)
        inverse[:3, :3] = rotation.T
        inverse[:3, 3] = -rotation.T @ translation
        return inverse


def check_rigid(pose: NDArray[np.float64], *, field: str, tolerance: float = 1e-3) -> None:
    """Raise `InvalidInputError` unless `pose` is a finite rigid [4, 4] transform with determinant +1."""
    if pose.shape != (4, 4):
        raise InvalidInputError(f"{field}: a matrix of shape {pose.shape}, expected (4, 4)", field=field)
    if not np.isfinite(pose).all():
        raise InvalidInputError(f"{field}: the matrix has NaN or infinite numbers", field=field)
    rotation = pose[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > tolerance or np.linalg.det(rotation) < 0:
        raise InvalidInputError(
            f"{field}: the upper 3×3 block is not a rotation",
            field=field,
            hint="Send world-from-camera with orthonormal axes and determinant +1; remove scale and mirroring.",
        )
    if np.abs(pose[3] - np.array([0.0, 0.0, 0.0, 1.0])).max() > tolerance:
        raise InvalidInputError(f"{field}: the last row is {pose[3].tolist()}, expected 0 0 0 1", field=field)
