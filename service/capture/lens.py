"""Lenses with distortion: every camera model of COLMAP, and what an undistorted image of each looks like."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray

from fastsplat_contract.camera import Camera
from fastsplat_contract.errors import InvalidInputError

_PLAIN = frozenset({"SIMPLE_PINHOLE", "PINHOLE"})
_ZERO_IS_PLAIN = frozenset({"SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV", "SIMPLE_DIVISION", "DIVISION"})
_MAX_PARAMETER = 100.0
_ROUND_TRIP_PX = 0.5
_MAX_SIDE = 1_000_000


@dataclass(frozen=True)
class Lens:
    """Intrinsics as COLMAP writes them (https://colmap.github.io/cameras.html); pixel centres at +0.5.

    Attributes:
        model: COLMAP's name, e.g. "OPENCV".
        width, height: of the image that the parameters are for.
        params: in COLMAP's order for the model, focal lengths and principal point in pixels.
    """

    model: str
    width: int
    height: int
    params: tuple[float, ...]

    def scaled_to(self, width: int, height: int) -> Lens:
        """The same lens for an image of another size; the aspect may differ by rounding."""
        camera = _colmap(self)
        camera.rescale(width, height)
        return Lens(self.model, width, height, tuple(float(value) for value in camera.params))

    @property
    def is_plain(self) -> bool:
        """Whether the lens has no distortion to undo."""
        first = len(self.params) - _extra_parameters(self.model)
        return self.model in _PLAIN or (self.model in _ZERO_IS_PLAIN and not any(self.params[first:]))


@dataclass(frozen=True)
class Undistortion:
    """How to resample a distorted image into a pinhole camera's.

    Attributes:
        camera: of the undistorted image.
        map_xy: float32 [H, W, 2], where each of its pixels lies in the distorted image (OpenCV's convention: pixel
            centres at integers), or None when the pixels stay as they are.
    """

    camera: Camera
    map_xy: NDArray[np.float32] | None

    def apply(self, pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """uint8 [H, W, 3] resampled; black where the distorted image has no content."""
        if self.map_xy is None:
            return pixels
        return np.asarray(cv2.remap(pixels, *self._maps(), cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT))

    def apply_to_ids(self, ids: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """uint16 [H, W] resampled to the nearest neighbour; 0 where the distorted image has no content."""
        if self.map_xy is None:
            return ids
        return np.asarray(cv2.remap(ids, *self._maps(), cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT))

    def _maps(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        assert self.map_xy is not None
        return np.ascontiguousarray(self.map_xy[..., 0]), np.ascontiguousarray(self.map_xy[..., 1])

    def valid(self, width: int, height: int) -> NDArray[np.bool_] | None:
        """bool [H, W]: where the distorted image has content, or None when that is everywhere."""
        if self.map_xy is None:
            return None
        x, y = self.map_xy[..., 0], self.map_xy[..., 1]
        inside = (x > -0.5) & (y > -0.5) & (x < width - 0.5) & (y < height - 0.5)
        return None if bool(inside.all()) else inside


def turned(way: Undistortion, quarter_turns: int, width: int, height: int) -> Undistortion:
    """The same undistortion once both images are turned clockwise by quarters.

    Args:
        width, height: of the distorted image before the turn.
    """
    camera, map_xy = way.camera, way.map_xy
    for _ in range(quarter_turns % 4):
        camera = Camera(camera.height, camera.width, camera.fy, camera.fx, camera.height - camera.cy, camera.cx)
        if map_xy is not None:
            spun = np.rot90(map_xy, -1)
            map_xy = np.ascontiguousarray(np.stack([height - 1 - spun[..., 1], spun[..., 0]], axis=-1))
        width, height = height, width
    return Undistortion(camera, map_xy)


def turned_pose(world_from_camera: NDArray[np.float64], quarter_turns: int) -> NDArray[np.float64]:
    """float64 [4, 4]: pose of the camera whose image is turned clockwise by quarters."""
    old_from_new = np.array([[0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    return np.asarray(world_from_camera @ np.linalg.matrix_power(old_from_new, quarter_turns % 4))


def check_lens(lens: Lens, *, field: str) -> None:
    """Refuse a lens that no camera has.

    Raises:
        InvalidInputError: an unknown or spherical model, a wrong number of parameters, NaN, a focal length or principal
            point far from the image's size, or distortion that folds the image over itself.
    """
    if lens.model not in _models():
        known = ", ".join(sorted(_models()))
        raise InvalidInputError(
            f"{field}: the camera model {lens.model[:40]!r} is unknown", field=field, hint=f"Use one of {known}."
        )
    count = _models()[lens.model]
    values = np.array(lens.params, dtype=np.float64)
    if len(values) != count or not np.isfinite(values).all():
        raise InvalidInputError(
            f"{field}: a {lens.model} camera with parameters {list(lens.params)[:16]}",
            field=field,
            hint=f"{lens.model} needs {count} finite numbers.",
        )
    if not 1 <= min(lens.width, lens.height) <= max(lens.width, lens.height) <= _MAX_SIDE:
        raise InvalidInputError(
            f"{field}: an image of {lens.width}×{lens.height} pixels", field=field, hint="Give its size in pixels."
        )
    camera = _colmap(lens)
    focal = np.array([camera.focal_length_x, camera.focal_length_y])
    size = np.array([lens.width, lens.height])
    if (focal < 0.02 * size.max()).any() or (focal > 100 * size.max()).any() or focal.max() > 10 * focal.min():
        raise InvalidInputError(
            f"{field}: focal lengths {focal.tolist()} for an image of {lens.width}×{lens.height} pixels",
            field=field,
            hint="Give focal lengths in pixels of the image.",
        )
    centre = np.array([camera.principal_point_x, camera.principal_point_y])
    if (centre < -size).any() or (centre > 2 * size).any():
        raise InvalidInputError(
            f"{field}: the principal point {centre.tolist()} lies far outside {lens.width}×{lens.height} pixels",
            field=field,
            hint="Give cx and cy in pixels of the image.",
        )
    extra = values[count - _extra_parameters(lens.model) :] if lens.model not in _PLAIN else np.zeros(0)
    if (np.abs(extra) > _MAX_PARAMETER).any():
        raise InvalidInputError(
            f"{field}: distortion {extra.tolist()} is absurd", field=field, hint="Check the order of the parameters."
        )


def undistortion(lens: Lens, max_side: int, *, field: str) -> Undistortion:
    """A pinhole camera that sees as much of the lens's image as fits without blank borders, and the way there.

    Pixels of a plain lens stay as they are. The pinhole's extent follows COLMAP's `undistort_camera`.

    Raises:
        InvalidInputError: the distortion cannot be undone over the undistorted image.
    """
    if lens.is_plain:
        camera = _colmap(lens)
        plain = Camera(
            lens.width,
            lens.height,
            camera.focal_length_x,
            camera.focal_length_y,
            camera.principal_point_x,
            camera.principal_point_y,
        )
        return Undistortion(plain, None)
    distorted = _colmap(lens)
    pinhole = pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), distorted)
    longer = max(pinhole.width, pinhole.height)
    if longer > max_side:
        shrink = max_side / longer
        pinhole.rescale(max(1, round(pinhole.width * shrink)), max(1, round(pinhole.height * shrink)))
    fx, fy, cx, cy = (float(value) for value in pinhole.params)
    undistorted = Camera(pinhole.width, pinhole.height, fx, fy, cx, cy)
    x, y = np.meshgrid(np.arange(undistorted.width) + 0.5, np.arange(undistorted.height) + 0.5)
    rays = np.stack([(x - cx) / fx, (y - cy) / fy, np.ones_like(x)], axis=-1).reshape(-1, 3)
    pixels = np.asarray(distorted.img_from_cam(rays))
    _check_invertible(distorted, rays, pixels, field)
    pixels = np.where(np.isfinite(pixels), pixels, -1e6)
    map_xy = (pixels - 0.5).astype(np.float32).reshape(undistorted.height, undistorted.width, 2)
    return Undistortion(undistorted, map_xy)


def _check_invertible(
    camera: pycolmap.Camera, rays: NDArray[np.float64], pixels: NDArray[np.float64], field: str
) -> None:
    """A polynomial beyond its turning point maps two directions to one pixel, and the picture folds over itself."""
    step = max(1, len(rays) // 400)
    some, there = rays[::step, :2], pixels[::step]
    inside = np.isfinite(there).all(1) & (there >= 0).all(1) & (there <= [camera.width, camera.height]).all(1)
    if not inside.any():
        raise InvalidInputError(f"{field}: the undistorted image is empty", field=field, hint="Check the distortion.")
    back = np.asarray(camera.cam_from_img(there[inside]))
    slip = np.abs(back - some[inside]).max(axis=1) * camera.mean_focal_length()
    if not (slip < _ROUND_TRIP_PX).all():  # NaN counts as a slip too
        raise InvalidInputError(
            f"{field}: the distortion {camera.params_to_string()} folds the image over itself",
            field=field,
            hint="Check the distortion parameters and their order.",
        )


def _colmap(lens: Lens) -> pycolmap.Camera:
    return pycolmap.Camera(
        model=lens.model, width=lens.width, height=lens.height, params=np.array(lens.params, dtype=np.float64)
    )


@cache
def _models() -> dict[str, int]:
    """Perspective camera models and how many parameters each has."""
    made = {
        name: pycolmap.Camera.create_from_model_id(1, model, 1.0, 2, 2)
        for name, model in pycolmap.CameraModelId.__members__.items()
        if name != "INVALID"
    }
    return {name: len(camera.params) for name, camera in made.items() if camera.is_perspective()}


@cache
def model_names() -> dict[int, str]:
    """COLMAP's numbers of the camera models, as its binary files have them."""
    return {int(model): name for name, model in pycolmap.CameraModelId.__members__.items() if name in _models()}


def parameter_count(model: str) -> int:
    """How many parameters a model of `model_names` has."""
    return _models()[model]


def _extra_parameters(model: str) -> int:
    camera = pycolmap.Camera.create_from_model_id(1, pycolmap.CameraModelId.__members__[model], 1.0, 2, 2)
    return len(camera.extra_params_idxs())
