"""COLMAP's camera models and the undistortion of their images."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray

from fastsplat.service.common.radial_lens import RadialLens
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import Camera

_PINHOLES = frozenset({"SIMPLE_PINHOLE", "PINHOLE"})
_PINHOLES_AT_ZERO = frozenset({"SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV", "SIMPLE_DIVISION", "DIVISION"})
_MAX_DISTORTION = 100.0
_MAX_ROUND_TRIP_PX = 0.5
_MAX_SIDE = 1_000_000
_ASPECT_TOLERANCE_PX = 1.0
_LENS_TOLERANCE = 0.002  # largest misfit of a `RadialLens`, over the longer side


@dataclass(frozen=True)
class CameraModel:
    """Intrinsics with distortion as in COLMAP (https://colmap.github.io/cameras.html); pixel centers at +0.5."""

    model: str  # COLMAP's name, e.g. "OPENCV"
    width: int
    height: int
    params: tuple[float, ...]  # in COLMAP's order, focal lengths and principal point in pixels
    circle_px: float | None = None  # radius of a fisheye's image circle around the principal point; None: unlimited

    def fits(self, width: int, height: int) -> bool:
        """Checks for an equal aspect, so that the model can be scaled to `width`×`height`."""
        scale = (width / self.width + height / self.height) / 2
        tolerance = _ASPECT_TOLERANCE_PX * max(1.0, scale)
        return abs(self.width * scale - width) <= tolerance and abs(self.height * scale - height) <= tolerance

    def scaled_to(self, width: int, height: int) -> CameraModel:
        """Scales the camera to another image size; the aspect may differ by rounding."""
        camera = colmap_camera(self)
        camera.rescale(width, height)
        circle_px = None if self.circle_px is None else self.circle_px * (width / self.width + height / self.height) / 2
        return CameraModel(self.model, width, height, tuple(float(value) for value in camera.params), circle_px)

    @property
    def has_distortion(self) -> bool:
        """Checks for distortion to undo."""
        if self.model in _PINHOLES:
            return False
        return self.model not in _PINHOLES_AT_ZERO or any(_distortion(self))


@dataclass(frozen=True)
class Undistortion:
    """Resampling of a distorted image into a pinhole camera's."""

    camera: Camera  # undistorted
    map_xy: NDArray[np.float32] | None  # [H, W, 2], pixels in the distorted image
    """In OpenCV's convention, pixel centers at integers; None if pixels stay unchanged."""
    lens: RadialLens | None = None  # of the distorted image, if it fits one

    def apply(self, pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Resamples uint8 [H, W, 3]; black where the distorted image has no content."""
        if self.map_xy is None:
            return pixels
        return np.asarray(cv2.remap(pixels, *self._maps(), cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT))

    def apply_to_ids(self, ids: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Resamples uint16 [H, W] to the nearest neighbor; 0 without content."""
        if self.map_xy is None:
            return ids
        return np.asarray(cv2.remap(ids, *self._maps(), cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT))

    def valid(self, width: int, height: int) -> NDArray[np.bool_] | None:
        """Masks pixels with content in the distorted image, bool [H, W]; None if all have."""
        if self.map_xy is None:
            return None
        x, y = self.map_xy[..., 0], self.map_xy[..., 1]
        inside = (x > -0.5) & (y > -0.5) & (x < width - 0.5) & (y < height - 0.5)
        return None if bool(inside.all()) else inside

    def _maps(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        assert self.map_xy is not None
        return np.ascontiguousarray(self.map_xy[..., 0]), np.ascontiguousarray(self.map_xy[..., 1])


def rotate90(undistortion: Undistortion, quarter_turns: int, width: int, height: int) -> Undistortion:
    """Rotates both images clockwise by quarter turns; the size is the distorted image's, before."""
    camera, map_xy = undistortion.camera, undistortion.map_xy
    for _ in range(quarter_turns % 4):
        camera = Camera(camera.height, camera.width, camera.fy, camera.fx, camera.height - camera.cy, camera.cx)
        if map_xy is not None:
            rotated = np.rot90(map_xy, -1)
            map_xy = np.ascontiguousarray(np.stack([height - 1 - rotated[..., 1], rotated[..., 0]], axis=-1))
        width, height = height, width
    return Undistortion(camera, map_xy, undistortion.lens)


def rotate90_pose(world_from_camera: NDArray[np.float64], quarter_turns: int) -> NDArray[np.float64]:
    """Pose of a camera whose image is rotated clockwise by quarter turns, float64 [4, 4]."""
    old_from_new = np.array([[0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    return np.asarray(world_from_camera @ np.linalg.matrix_power(old_from_new, quarter_turns % 4))


def check_camera_model(camera_model: CameraModel, *, field: str) -> None:
    """Refuses an impossible camera model.

    Raises:
        InvalidInputError: an unknown or spherical model, a wrong number of parameters, NaN, a focal length or principal
            point far from the image's size, or absurd distortion.
    """
    model, width, height = camera_model.model, camera_model.width, camera_model.height
    if model not in _parameter_counts():
        known = ", ".join(sorted(_parameter_counts()))
        raise InvalidInputError.of(field, f": the camera model {model[:40]!r} is unknown", f"Use one of {known}.")
    count = _parameter_counts()[model]
    values = np.array(camera_model.params, dtype=np.float64)
    if len(values) != count or not np.isfinite(values).all():
        raise InvalidInputError.of(
            field,
            f": a {model} camera with parameters {list(camera_model.params)[:16]}",
            f"{model} needs {count} finite numbers.",
        )
    if not 1 <= min(width, height) <= max(width, height) <= _MAX_SIDE:
        raise InvalidInputError.of(field, f": an image of {width}×{height} pixels", "Give its size in pixels.")
    camera = colmap_camera(camera_model)
    focal = np.array([camera.focal_length_x, camera.focal_length_y])
    size = np.array([width, height])
    if (focal < 0.02 * size.max()).any() or (focal > 100 * size.max()).any() or focal.max() > 10 * focal.min():
        raise InvalidInputError.of(
            field,
            f": focal lengths {focal.tolist()} for an image of {width}×{height} pixels",
            "Give focal lengths in pixels of the image.",
        )
    center = np.array([camera.principal_point_x, camera.principal_point_y])
    if (center < -size).any() or (center > 2 * size).any():
        raise InvalidInputError.of(
            field,
            f": the principal point {center.tolist()} lies far outside {width}×{height} pixels",
            "Give cx and cy in pixels of the image.",
        )
    if camera_model.circle_px is not None and not camera_model.circle_px > 0:  # NaN too
        raise InvalidInputError.of(
            field, f": an image circle of radius {camera_model.circle_px:g}", "Give it in pixels."
        )
    distortion = _distortion(camera_model)
    if any(abs(value) > _MAX_DISTORTION for value in distortion):
        raise InvalidInputError.of(
            field,
            f": distortion {list(distortion)} is larger than any lens has",
            "Check the order of the parameters.",
            f"{_MAX_DISTORTION:g} a parameter",
        )


def aspect_error(name: str, camera_model: CameraModel, width: int, height: int) -> InvalidInputError:
    """Makes the error of intrinsics that do not fit their image, see `CameraModel.fits`."""
    return InvalidInputError.of(
        name,
        f"has {width}×{height} pixels, its intrinsics are for {camera_model.width}×{camera_model.height}: "
        "another aspect ratio",
        "Send the images that the intrinsics were made for, or a resized, never a cropped or rotated, version.",
    )


def compute_undistortion(camera_model: CameraModel, max_side: int, *, field: str) -> Undistortion:
    """Computes the undistortion into the largest pinhole view without blank borders.

    Pixels without distortion stay unchanged. The pinhole's extent follows COLMAP's `undistort_camera`.

    Args:
        camera_model: for the size of the distorted image.
        max_side: limit of the undistorted image's longer side, pixels.

    Raises:
        InvalidInputError: the distortion cannot be undone over the undistorted image.
    """
    distorted = colmap_camera(camera_model)
    if not camera_model.has_distortion:
        focal = (distorted.focal_length_x, distorted.focal_length_y)
        center = (distorted.principal_point_x, distorted.principal_point_y)
        undistorted = Camera(camera_model.width, camera_model.height, *focal, *center)
        return Undistortion(undistorted, None, _radial_lens(distorted, undistorted))
    pinhole = pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), distorted)
    longer = max(pinhole.width, pinhole.height)
    if longer > max_side:
        scale = max_side / longer
        pinhole.rescale(max(1, round(pinhole.width * scale)), max(1, round(pinhole.height * scale)))
    fx, fy, cx, cy = (float(value) for value in pinhole.params)
    undistorted = Camera(pinhole.width, pinhole.height, fx, fy, cx, cy)
    x, y = np.meshgrid(np.arange(undistorted.width) + 0.5, np.arange(undistorted.height) + 0.5)
    rays = np.stack([(x - cx) / fx, (y - cy) / fy, np.ones_like(x)], axis=-1).reshape(-1, 3)
    pixels = np.asarray(distorted.img_from_cam(rays))
    _check_invertible(distorted, rays, pixels, field)
    pixels = np.where(np.isfinite(pixels), pixels, -1e6)
    map_xy = (pixels - 0.5).astype(np.float32).reshape(undistorted.height, undistorted.width, 2)
    return Undistortion(undistorted, map_xy, _radial_lens(distorted, undistorted))


def _radial_lens(distorted: pycolmap.Camera, seen: Camera) -> RadialLens | None:
    """Fits a `RadialLens` over a pinhole's view by least squares; None beyond `_LENS_TOLERANCE`."""
    x = np.array([-seen.cx, seen.width - seen.cx]) / seen.fx
    y = np.array([-seen.cy, seen.height - seen.cy]) / seen.fy
    corners = np.stack([part.ravel() for part in np.meshgrid(x, y)], axis=-1)
    places = (np.linspace(0.1, 1.0, 10)[:, None, None] * corners).reshape(-1, 2)
    pixels = np.asarray(distorted.img_from_cam(np.column_stack([places, np.ones(len(places))])))
    pixels = (pixels - [distorted.principal_point_x, distorted.principal_point_y]).ravel()
    columns = np.stack([places.ravel(), (places * (places**2).sum(axis=1, keepdims=True)).ravel()], axis=-1)
    (focal, cubic), *_ = np.linalg.lstsq(columns, pixels, rcond=None)
    longer = max(distorted.width, distorted.height)
    if not np.abs(columns @ [focal, cubic] - pixels).max() < _LENS_TOLERANCE * longer:
        return None
    return RadialLens(float(focal / longer), float(cubic / focal))


@cache
def model_names() -> dict[int, str]:
    """Maps COLMAP's camera model ids, as in its binary files, to names."""
    models = pycolmap.CameraModelId.__members__.items()
    return {int(model): name for name, model in models if name in _parameter_counts()}


def parameter_count(model: str) -> int:
    """Number of parameters of a model of `model_names`."""
    return _parameter_counts()[model]


def _check_invertible(
    camera: pycolmap.Camera, rays: NDArray[np.float64], pixels: NDArray[np.float64], field: str
) -> None:
    """Refuses distortion that folds the image: beyond its turning point, a polynomial is not invertible."""
    step = max(1, len(rays) // 400)
    expected, sampled = rays[::step, :2], pixels[::step]
    inside = np.isfinite(sampled).all(1) & (sampled >= 0).all(1) & (sampled <= [camera.width, camera.height]).all(1)
    if not inside.any():
        raise InvalidInputError(f"{field}: the undistorted image is empty", field=field, hint="Check the distortion.")
    round_trip = np.asarray(camera.cam_from_img(sampled[inside]))
    error_px = np.abs(round_trip - expected[inside]).max(axis=1) * camera.mean_focal_length()
    if not (error_px < _MAX_ROUND_TRIP_PX).all():  # NaN counts as an error too
        raise InvalidInputError.of(
            field,
            f": the distortion {camera.params_to_string()} folds the image over itself",
            "Check the distortion parameters and their order.",
        )


def colmap_camera(camera_model: CameraModel) -> pycolmap.Camera:
    """Converts to pycolmap."""
    return pycolmap.Camera(
        model=camera_model.model,
        width=camera_model.width,
        height=camera_model.height,
        params=np.array(camera_model.params, dtype=np.float64),
    )


@cache
def _parameter_counts() -> dict[str, int]:
    """Numbers of parameters of the perspective camera models."""
    cameras = {name: _example(name) for name in pycolmap.CameraModelId.__members__ if name != "INVALID"}
    return {name: len(camera.params) for name, camera in cameras.items() if camera.is_perspective()}


def _distortion(camera_model: CameraModel) -> tuple[float, ...]:
    """Parameters after focal lengths and principal point."""
    if camera_model.model in _PINHOLES:
        return ()
    return camera_model.params[len(camera_model.params) - len(_example(camera_model.model).extra_params_idxs()) :]


def _example(model: str) -> pycolmap.Camera:
    return pycolmap.Camera.create_from_model_id(1, pycolmap.CameraModelId.__members__[model], 1.0, 2, 2)
