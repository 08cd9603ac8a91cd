"""Pinhole cameras and where they stand. OpenCV axes (x right, y down, z forward); pixel centers at +0.5."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from fastsplat_contract.codec.wire import OneOf
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry import viewpoint
from fastsplat_contract.geometry.poses import quaternion_of, rigid, vector3

OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
ViewName = Annotated[
    str | None, OneOf("viewpoint"), Field(description="name of one of the scene's own cameras, instead of `camera`")
]
_IDENTITY = np.eye(3)
_TOLERANCE = 1e-3  # of the entries of a rigid transform


@dataclass(frozen=True)
class Camera:
    """Intrinsics of an undistorted image, in pixels of that image.

    A point (x, y, z) of the camera frame, z > 0, lands at (fx·x/z + cx, fy·y/z + cy), where the center of the
    top-left pixel is (0.5, 0.5).

    Examples:
        >>> camera = Camera(width=640, height=480, fx=500.0, fy=500.0, cx=320.0, cy=240.0)
        >>> camera.scaled_to(320, 240).fx, camera.rays(320.0, 490.0).tolist()
        (250.0, [0.0, 0.5, 1.0])
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
        """The same camera with an image of another size (the aspect may differ by rounding)."""
        sx, sy = width / self.width, height / self.height
        return Camera(width, height, self.fx * sx, self.fy * sy, self.cx * sx, self.cy * sy)

    def limited_to(self, side: int) -> Camera:
        """The same camera, scaled down until its longer side has at most `side` pixels."""
        share = min(1.0, side / max(self.width, self.height))
        return self.scaled_to(max(1, round(self.width * share)), max(1, round(self.height * share)))

    def rays(self, x: NDArray[Any] | float, y: NDArray[Any] | float) -> NDArray[np.float64]:
        """Returns the points of depth 1 that land at pixels x, y of a shape [...]: camera frame, float64 [..., 3]."""
        across, down = (np.asarray(x) - self.cx) / self.fx, (np.asarray(y) - self.cy) / self.fy
        return np.stack([across, down, np.ones_like(across)], axis=-1)


@dataclass(frozen=True)
class PosedCamera:
    """A camera and where it stands. Travels as `viewpoint.PosedCamera`.

    Attributes:
        world_from_camera: float64 [4, 4], rigid (rotation and translation, last row 0 0 0 1), scene units.
        name: the image's file name in the capture, or "" for a free viewpoint.
        frame_id: name of the world frame, as in `viewpoint.PosedCamera`.

    Examples:
        >>> from fastsplat_contract.geometry.poses import look_at
        >>> posed = PosedCamera(Camera(640, 480, 500.0, 500.0, 320.0, 240.0), look_at([0, -2, 0], [0, 0, 0]))
        >>> posed.camera_from_world() @ [0, 0, 0, 1], posed.pixels(np.zeros(3))
        (array([0., 0., 2., 1.]), array([320., 240.]))
    """

    wire: ClassVar[type] = viewpoint.PosedCamera

    camera: Camera
    world_from_camera: NDArray[np.float64]
    name: str = ""
    frame_id: str = viewpoint.WORLD

    def __post_init__(self) -> None:
        check_rigid(self.world_from_camera, field=f"pose of {self.name}" if self.name else "pose")

    def camera_from_world(self) -> NDArray[np.float64]:
        """float64 [4, 4]: the inverse pose, what the field calls a viewmat."""
        rotation, translation = self.world_from_camera[:3, :3], self.world_from_camera[:3, 3]
        inverse = np.eye(4)
        inverse[:3, :3] = rotation.T
        inverse[:3, 3] = -rotation.T @ translation
        return inverse

    def limited_to(self, side: int) -> PosedCamera:
        """As `Camera.limited_to`."""
        return replace(self, camera=self.camera.limited_to(side))

    def pixels(self, points: NDArray[Any]) -> NDArray[np.float64]:
        """Where world points [..., 3] land, float64 [..., 2]; infinite if not in front of the camera."""
        local = (points - self.world_from_camera[:3, 3]) @ self.world_from_camera[:3, :3]
        camera = self.camera
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = local[..., :2] / local[..., 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
        return np.where(local[..., 2:] > 0, pixels, np.inf)

    def in_picture(self, points: NDArray[Any]) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
        """Rows of the world points [P, 3] in the picture, [K], hidden or not; their pixels [K, 2] and depths [K]."""
        pixels = self.pixels(points)
        rows = np.flatnonzero(((pixels >= 0) & (pixels < (self.camera.width, self.camera.height))).all(axis=1))
        return rows, pixels[rows], (points[rows] - self.world_from_camera[:3, 3]) @ self.world_from_camera[:3, 2]

    def places(self, x: NDArray[Any], y: NDArray[Any], depths: NDArray[Any]) -> NDArray[np.float64]:
        """World points [..., 3] that land at pixels x, y, with depths of the same shape [...]."""
        pose = self.world_from_camera
        return np.asarray((self.camera.rays(x, y) * depths[..., None]) @ pose[:3, :3].T + pose[:3, 3])

    def to_wire(self) -> viewpoint.PosedCamera:
        """Position and quaternion x y z w with w ≥ 0, in OpenCV axes and the world frame."""
        pose = self.world_from_camera
        lens = viewpoint.Intrinsics(**vars(self.camera))
        position, turn = vector3(pose[:3, 3]), quaternion_of(pose[:3, :3])
        return viewpoint.PosedCamera(lens, position, turn, "OPENCV", self.frame_id, self.name)

    @classmethod
    def from_wire(cls, sent: viewpoint.PosedCamera) -> PosedCamera:
        """Back from `to_wire`, of either convention; the quaternion is of unit length."""
        pose = rigid(sent.orientation, sent.position)
        if sent.convention == "OPENGL":
            pose = pose @ OPENCV_FROM_OPENGL
        return cls(Camera(**vars(sent.intrinsics)), pose, sent.name, sent.frame_id)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        form = handler.generate_schema(viewpoint.PosedCamera)
        return core_schema.no_info_after_validator_function(
            cls.from_wire,
            form,
            serialization=core_schema.plain_serializer_function_ser_schema(cls.to_wire, return_schema=form),
        )


def check_rigid(pose: NDArray[np.float64], *, field: str) -> None:
    """Raise `InvalidInputError` unless `pose` is a finite rigid [4, 4] transform with determinant +1."""
    if pose.shape != (4, 4):
        raise InvalidInputError(f"{field}: a matrix of shape {pose.shape}, expected (4, 4)", field=field)
    if not np.isfinite(pose).all():
        raise InvalidInputError(f"{field}: the matrix has NaN or infinite numbers", field=field)
    rotation = pose[:3, :3]
    if np.abs(rotation @ rotation.T - _IDENTITY).max() > _TOLERANCE or np.linalg.det(rotation) < 0:
        raise InvalidInputError.of(
            field,
            ": the upper 3×3 block is not a rotation",
            "Send world-from-camera with orthonormal axes and determinant +1; remove scale and mirroring.",
        )
    if np.abs(pose[3] - np.array([0.0, 0.0, 0.0, 1.0])).max() > _TOLERANCE:
        raise InvalidInputError(f"{field}: the last row is {pose[3].tolist()}, expected 0 0 0 1", field=field)
