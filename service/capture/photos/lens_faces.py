"""Pinhole faces that wide lenses and 360° panoramas are cut into, and how much of the picture they cover."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import PurePosixPath

import numpy as np
import pycolmap
from numpy.typing import NDArray

from fastsplat.service.capture.photos.camera_model import CameraModel, Undistortion, compute_undistortion
from fastsplat_contract.camera import Camera
from fastsplat_contract.errors import InvalidInputError

F64 = NDArray[np.float64]

FACE_FOV_DEG = 96.0
"""Of a square face: six of 90° would cover the sphere, these overlap by 6°."""
FACES: dict[str, F64] = {
    "front": np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    "right": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
    "back": np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]),
    "left": np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
    "up": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "down": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
}
"""Of a cube: float64 [3, 3], rotations of a face's camera into the frame of the whole, OpenCV axes."""

_FISHEYES = frozenset({
    "OPENCV_FISHEYE", "FISHEYE", "SIMPLE_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE",
    "RAD_TAN_THIN_PRISM_FISHEYE", "FOV", "EUCM",
})  # fmt: skip
_ONE_PINHOLE_DEG = 120.0
"""Up to this field of view one pinhole shows a lens: at its rim a pixel is stretched four times."""
_NARROW_DEG = 100.0
"""Up to this one, it shows what it can without a blank border, as of lenses that are no fisheyes."""
_MOST_DEG = 88.0
"""From the optical axis: beyond, structure from motion has no image points."""
_LEAST_DEG = 10.0
_LEAST_SHARE = 0.03
"""A face of which less has content is left out."""
_TABLE = 256
_DIRECTIONS = 48
_COVERAGE_GRID = 64


@dataclass(frozen=True)
class LensFace:
    """One pinhole view of a wide picture.

    Attributes:
        name: of `FACES`; "" where the picture has only this one.
        camera_from_face: float64 [3, 3], rotation of the face's camera into the frame of the lens.
        undistortion: resamples the picture into the face.
    """

    name: str
    camera_from_face: F64
    undistortion: Undistortion

    def pose(self, world_from_camera: F64) -> F64:
        """float64 [4, 4]: the face's pose by that of the lens."""
        pose = world_from_camera.copy()
        pose[:3, :3] = world_from_camera[:3, :3] @ self.camera_from_face
        return pose


@dataclass(frozen=True)
class WideLens:
    """The faces of a fisheye lens.

    Attributes:
        faces: one for a field of view up to 120°, else those of a cube that have content.
        field_of_view_deg: how wide or high the picture is through its middle, whichever is more, as far as it is
            used; 0 of a lens that is no wider than others.
        covered: share of the picture's pixels that lie in a face.
    """

    faces: tuple[LensFace, ...]
    field_of_view_deg: float
    covered: float


def is_fisheye(camera_model: CameraModel) -> bool:
    """Whether the model is made for lenses wider than a pinhole shows."""
    return camera_model.model in _FISHEYES


def face_name(name: str, face: str) -> str:
    """The name of a face's view: `hall/a.jpg` and `left` give `hall/a.left.jpg`."""
    path = PurePosixPath(name)
    return path.with_name(f"{path.stem}.{face}{path.suffix}").as_posix() if face else name


def face_camera(side: int) -> Camera:
    """The pinhole of a square face of `side` pixels."""
    focal = side / 2 / np.tan(np.radians(FACE_FOV_DEG / 2))
    return Camera(side, side, float(focal), float(focal), side / 2, side / 2)


def face_rays(camera: Camera) -> F64:
    """float64 [H, W, 3]: directions of a pinhole's pixels, z = 1."""
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    return camera.rays(x, y)


def fisheye_faces(camera_model: CameraModel, max_side: int, field: str) -> WideLens:
    """The pinhole faces of a fisheye lens.

    Args:
        camera_model: of `is_fisheye`, for the size of the picture.
        max_side: longest side of a face in pixels.

    Raises:
        InvalidInputError: the distortion folds the picture over itself near its middle.
    """
    lens = _wide_lens(camera_model, max_side)
    if lens is None:
        raise InvalidInputError.of(
            field,
            f": the distortion {list(camera_model.params)[:16]} folds the image over itself",
            "Check the distortion parameters and their order.",
        )
    if not lens.faces:
        undistortion = compute_undistortion(camera_model, max_side, field=field)
        return replace(lens, faces=(LensFace("", np.eye(3), undistortion),))
    return lens


@lru_cache(maxsize=2)
def _wide_lens(camera_model: CameraModel, max_side: int) -> WideLens | None:
    """As `fisheye_faces`, but no faces of a lens that is no wider than others; None where the distortion folds the
    picture. Photos of one upload mostly share a camera, whose maps take a second and some ten megabytes."""
    lens = _Lens(camera_model)
    field_of_view = lens.field_of_view_deg()
    if field_of_view < _LEAST_DEG:
        return None
    if field_of_view <= _NARROW_DEG and camera_model.circle_px is None:
        return WideLens((), 0.0, 1.0)
    if field_of_view <= _ONE_PINHOLE_DEG:
        faces: tuple[LensFace, ...] = (LensFace("", np.eye(3), lens.undistortion(lens.pinhole(max_side), np.eye(3))),)
    else:
        side = min(max_side, max(16, round(2 * lens.focal_px * np.tan(np.radians(FACE_FOV_DEG / 2)))))
        faces = tuple(
            LensFace(name, rotation, undistortion)
            for name, rotation in FACES.items()
            if (undistortion := lens.trimmed(face_camera(side), rotation)) is not None
        )
    return WideLens(faces, field_of_view, lens.coverage(faces))


class _Lens:
    """A fisheye camera as far as its mapping of directions to pixels is one to one."""

    def __init__(self, camera_model: CameraModel) -> None:
        params = np.array(camera_model.params, dtype=np.float64)
        self._size = np.array([camera_model.width, camera_model.height])
        self._camera = pycolmap.Camera(
            model=camera_model.model, width=camera_model.width, height=camera_model.height, params=params
        )
        self._center = np.array([self._camera.principal_point_x, self._camera.principal_point_y])
        self._radius_px = camera_model.circle_px
        self.focal_px = float(self._camera.mean_focal_length())
        angles = np.radians(np.linspace(0.0, _MOST_DEG, _TABLE))
        around = np.linspace(0.0, 2 * np.pi, _DIRECTIONS, endpoint=False)
        self._table = np.degrees(angles)
        pixels = self._project(_directions(angles[None, :], around[:, None]).reshape(-1, 3))
        radii = np.linalg.norm(pixels - self._center, axis=1).reshape(_DIRECTIONS, _TABLE)
        growing = np.diff(radii, axis=1) > 0  # false for NaN
        last = np.where(growing.all(axis=1), _TABLE - 1, growing.argmin(axis=1))
        self.reach_deg = float(self._table[last.min()])
        """From the axis: up to here pixels move outwards as directions do, in every direction."""
        self._pixels = pixels.reshape(_DIRECTIONS, _TABLE, 2)

    def field_of_view_deg(self) -> float:
        """How wide or how high the picture is, whichever is more."""
        right, bottom, left, top = self._reaches()
        return max(right + left, bottom + top)

    def pinhole(self, max_side: int) -> Camera:
        """One pinhole as wide and as high as the picture, as sharp in the middle; the corners beyond are cropped."""
        right, bottom, left, top = (float(np.tan(np.radians(reach))) for reach in self._reaches())
        focal = min(self.focal_px, max_side / max(right + left, bottom + top))
        width, height = max(1, int((right + left) * focal)), max(1, int((bottom + top) * focal))
        return Camera(width, height, focal, focal, left * focal, top * focal)

    def _reaches(self) -> tuple[float, float, float, float]:
        """Degrees from the axis to the right, bottom, left and top of what the picture shows."""
        pixels = self._pixels[:: _DIRECTIONS // 4]
        shown = self._shown(pixels.reshape(-1, 2)).reshape(4, _TABLE) & (self._table <= self.reach_deg)
        right, bottom, left, top = np.where(shown, self._table, 0.0).max(axis=1).tolist()
        return right, bottom, left, top

    def undistortion(self, camera: Camera, camera_from_face: F64) -> Undistortion:
        """Resamples the picture into a face; pixels that it does not show lie far outside of it."""
        rays = face_rays(camera).reshape(-1, 3) @ camera_from_face.T
        angle = np.degrees(np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2]))
        pixels = np.full((len(rays), 2), -1e6)
        usable = angle < self.reach_deg
        pixels[usable] = self._project(rays[usable])
        pixels[~self._shown(pixels)] = -1e6
        return Undistortion(camera, (pixels - 0.5).astype(np.float32).reshape(camera.height, camera.width, 2))

    def trimmed(self, camera: Camera, camera_from_face: F64) -> Undistortion | None:
        """As `undistortion`, without rows and columns that show nothing; None where that is nearly all."""
        map_xy = self.undistortion(camera, camera_from_face).map_xy
        assert map_xy is not None
        valid = map_xy[..., 0] > -1e5
        if valid.mean() < _LEAST_SHARE:
            return None
        top, bottom = np.flatnonzero(valid.any(axis=1))[[0, -1]].tolist()
        left, right = np.flatnonzero(valid.any(axis=0))[[0, -1]].tolist()
        cropped = np.ascontiguousarray(map_xy[top : bottom + 1, left : right + 1])
        height, width = cropped.shape[:2]
        return Undistortion(Camera(width, height, camera.fx, camera.fy, camera.cx - left, camera.cy - top), cropped)

    def coverage(self, faces: tuple[LensFace, ...]) -> float:
        """Share of a grid of the picture's pixels, within the image circle, that are in a face."""
        x, y = np.meshgrid(*(np.linspace(0.0, size, _COVERAGE_GRID + 2)[1:-1] for size in self._size))
        pixels = np.column_stack([x.ravel(), y.ravel()])
        pixels = pixels[self._shown(pixels)]
        rays = np.asarray(self._camera.cam_ray_from_img(pixels))
        covered = np.zeros(len(pixels), bool)
        for face in faces:
            local, camera = rays @ face.camera_from_face, face.undistortion.camera
            with np.errstate(divide="ignore", invalid="ignore"):
                u = local[:, 0] / local[:, 2] * camera.fx + camera.cx
                v = local[:, 1] / local[:, 2] * camera.fy + camera.cy
            covered |= (local[:, 2] > 0) & (u >= 0) & (v >= 0) & (u <= camera.width) & (v <= camera.height)
        angle = np.degrees(np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2]))
        return float((covered & (angle < self.reach_deg)).mean()) if len(pixels) else 0.0

    def _project(self, rays: F64) -> F64:
        return np.asarray(self._camera.img_from_cam(np.ascontiguousarray(rays)))

    def _shown(self, pixels: F64) -> NDArray[np.bool_]:
        with np.errstate(invalid="ignore"):
            inside = ((pixels >= 0) & (pixels <= self._size)).all(axis=1)
            if self._radius_px is not None:
                inside &= np.linalg.norm(pixels - self._center, axis=1) <= self._radius_px
        return np.asarray(inside)


def _directions(angle: F64, around: F64) -> F64:
    """float64 [..., 3]: unit vectors at angles from the optical axis, radians."""
    across = np.sin(angle)
    return np.stack(np.broadcast_arrays(across * np.cos(around), across * np.sin(around), np.cos(angle)), axis=-1)


def lens_of(camera_model: CameraModel, max_side: int, *, field: str) -> WideLens:
    """The faces of any camera; one, without loss of content but at the rim, for all but fisheye lenses.

    Raises:
        InvalidInputError: the distortion cannot be undone.
    """
    if is_fisheye(camera_model):
        return fisheye_faces(camera_model, max_side, field)
    undistortion = compute_undistortion(camera_model, max_side, field=field)
    return WideLens((LensFace("", np.eye(3), undistortion),), 0.0, 1.0)
