"""Cuts wide-angle pictures and 360° panoramas into pinhole faces."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import PurePosixPath

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.photos.camera_model import CameraModel, Undistortion, colmap_camera, compute_undistortion
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import Camera, PosedCamera

F64 = NDArray[np.float64]

FACE_FOV_DEG = 96.0
"""Six square faces of 90° would cover the sphere; these overlap by 6°."""
FACES: dict[str, F64] = {
    "front": np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    "right": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
    "back": np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]),
    "left": np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
    "up": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "down": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
}
"""Cube faces: rotations of a face's camera into the lens frame, [3, 3], OpenCV axes."""

_FISHEYES = frozenset({
    "OPENCV_FISHEYE", "FISHEYE", "SIMPLE_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE",
    "RAD_TAN_THIN_PRISM_FISHEYE", "FOV", "EUCM",
})  # fmt: skip
_ONE_PINHOLE_DEG = 120.0
"""Limit of one pinhole's view, as it stretches pixels at the rim four times."""
_NARROW_DEG = 100.0
"""Largest field of view that is undistorted without a blank border, as other lenses are."""
_MOST_DEG = 88.0
"""Limit from the optical axis: beyond, structure from motion has no image points."""
_LEAST_DEG = 10.0
_LEAST_SHARE = 0.03  # faces with less content are dropped
_TABLE = 256
_DIRECTIONS = 48
_COVERAGE_GRID = 64


@dataclass(frozen=True)
class LensFace:
    """A pinhole view of a wide picture."""

    name: str  # of `FACES`; "" for the only face of a picture
    camera_from_face: F64  # [3, 3], rotation into the lens frame
    undistortion: Undistortion  # from the picture to the face

    def pose(self, world_from_camera: F64) -> F64:
        """Pose of the face, float64 [4, 4], from that of the lens."""
        pose = world_from_camera.copy()
        pose[:3, :3] = world_from_camera[:3, :3] @ self.camera_from_face
        return pose


@dataclass(frozen=True)
class WideLens:
    """Faces of a fisheye: one up to 120° of view, else cube faces with content."""

    faces: tuple[LensFace, ...]
    field_of_view_deg: float  # usable, the larger of horizontal and vertical; 0 for ordinary lenses
    covered: float  # share of the picture's pixels in a face


def is_fisheye(camera_model: CameraModel) -> bool:
    """Checks if the model is made for lenses wider than a pinhole's view."""
    return camera_model.model in _FISHEYES


def face_name(name: str, face: str) -> str:
    """Names a face's view: `hall/a.jpg` and `left` give `hall/a.left.jpg`."""
    path = PurePosixPath(name)
    return path.with_name(f"{path.stem}.{face}{path.suffix}").as_posix() if face else name


def face_camera(side: int) -> Camera:
    """Makes the pinhole of a square face of `side` pixels."""
    focal = side / 2 / np.tan(np.radians(FACE_FOV_DEG / 2))
    return Camera(side, side, float(focal), float(focal), side / 2, side / 2)


def face_rays(camera: Camera) -> F64:
    """Directions of a pinhole's pixels, float64 [H, W, 3], z = 1."""
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    return camera.rays(x, y)


def fisheye_faces(camera_model: CameraModel, max_side: int, field: str) -> WideLens:
    """Cuts a fisheye picture into pinhole faces.

    Args:
        camera_model: of `is_fisheye`, for the size of the picture.
        max_side: limit of a face's longer side, pixels.

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
    """Computes `fisheye_faces`; no faces for an ordinary field of view, None for a folding distortion.

    Cached because photos of an upload mostly share a camera, and maps take a second and some ten megabytes.
    """
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
    """A fisheye camera within the angle where its projection is one to one."""

    def __init__(self, camera_model: CameraModel) -> None:
        self._size = np.array([camera_model.width, camera_model.height])
        self._camera = colmap_camera(camera_model)
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
        """Angle from the axis up to which projection is monotonic in every direction."""
        self._pixels = pixels.reshape(_DIRECTIONS, _TABLE, 2)

    def field_of_view_deg(self) -> float:
        """The larger of the horizontal and vertical fields of view."""
        right, bottom, left, top = self._reaches()
        return max(right + left, bottom + top)

    def pinhole(self, max_side: int) -> Camera:
        """Makes a pinhole as wide, high and sharp as the picture's middle, without corners."""
        right, bottom, left, top = (float(np.tan(np.radians(reach))) for reach in self._reaches())
        focal = min(self.focal_px, max_side / max(right + left, bottom + top))
        width, height = max(1, int((right + left) * focal)), max(1, int((bottom + top) * focal))
        return Camera(width, height, focal, focal, left * focal, top * focal)

    def _reaches(self) -> tuple[float, float, float, float]:
        """Angles from the axis to the picture's right, bottom, left and top edges, degrees."""
        pixels = self._pixels[:: _DIRECTIONS // 4]
        visible = self._in_image(pixels.reshape(-1, 2)).reshape(4, _TABLE) & (self._table <= self.reach_deg)
        right, bottom, left, top = np.where(visible, self._table, 0.0).max(axis=1).tolist()
        return right, bottom, left, top

    def undistortion(self, camera: Camera, camera_from_face: F64) -> Undistortion:
        """Maps a face into the picture; pixels beyond it map far outside."""
        rays = face_rays(camera).reshape(-1, 3) @ camera_from_face.T
        angle = np.degrees(np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2]))
        pixels = np.full((len(rays), 2), -1e6)
        usable = angle < self.reach_deg
        pixels[usable] = self._project(rays[usable])
        pixels[~self._in_image(pixels)] = -1e6
        return Undistortion(camera, (pixels - 0.5).astype(np.float32).reshape(camera.height, camera.width, 2))

    def trimmed(self, camera: Camera, camera_from_face: F64) -> Undistortion | None:
        """Maps a face without its empty rows and columns; None if nearly all is empty."""
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
        """Share of the picture's pixels, within the image circle, that lie in a face."""
        x, y = np.meshgrid(*(np.linspace(0.0, size, _COVERAGE_GRID + 2)[1:-1] for size in self._size))
        pixels = np.column_stack([x.ravel(), y.ravel()])
        pixels = pixels[self._in_image(pixels)]
        rays = np.asarray(self._camera.cam_ray_from_img(pixels))
        covered = np.zeros(len(pixels), bool)
        for face in faces:
            covered[PosedCamera(face.undistortion.camera, face.pose(np.eye(4))).in_picture(rays)[0]] = True
        angle = np.degrees(np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2]))
        return float((covered & (angle < self.reach_deg)).mean()) if len(pixels) else 0.0

    def _project(self, rays: F64) -> F64:
        return np.asarray(self._camera.img_from_cam(np.ascontiguousarray(rays)))

    def _in_image(self, pixels: F64) -> NDArray[np.bool_]:
        with np.errstate(invalid="ignore"):
            inside = ((pixels >= 0) & (pixels <= self._size)).all(axis=1)
            if self._radius_px is not None:
                inside &= np.linalg.norm(pixels - self._center, axis=1) <= self._radius_px
        return np.asarray(inside)


def _directions(angle: F64, around: F64) -> F64:
    """Unit vectors at angles from the optical axis, radians; float64 [..., 3]."""
    across = np.sin(angle)
    return np.stack(np.broadcast_arrays(across * np.cos(around), across * np.sin(around), np.cos(angle)), axis=-1)


def lens_of(camera_model: CameraModel, max_side: int, *, field: str) -> WideLens:
    """Makes the faces of any camera; a lens that is no fisheye has one.

    Raises:
        InvalidInputError: the distortion cannot be undone.
    """
    if is_fisheye(camera_model):
        return fisheye_faces(camera_model, max_side, field)
    undistortion = compute_undistortion(camera_model, max_side, field=field)
    return WideLens((LensFace("", np.eye(3), undistortion),), 0.0, 1.0)
