"""What the recordings of all apps share: ARKit's axes, intrinsics, and how JSON of strangers is read.

ARKit's world has y up and meters; its cameras have x right, y up, z backward. Ours is z up, cameras are OpenCV's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.photos.camera_model import CameraModel, check_camera_model
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.capture.uploads.left_out import LeftOut
from fastsplat.service.capture.uploads.posed_input import PosedDataset, PosedImage, check_position, no_points
from fastsplat.service.common.similarity import nearest_rotation
from fastsplat_contract.camera import check_rigid
from fastsplat_contract.errors import InvalidInputError

_OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
_Z_UP = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
_AGAIN = "Export the recording again."
_Item = TypeVar("_Item")

F64 = NDArray[np.float64]


def world_from_camera(matrix: F64, field: str) -> F64:
    """float64 [4, 4], z up, OpenCV axes, of ARKit's camera transform [4, 4].

    Raises:
        InvalidInputError: it is not rigid.
    """
    try:
        check_rigid(matrix, field=field)
        check_position(matrix, field)
    except InvalidInputError as error:
        raise InvalidInputError(error.message, field=field, hint=_AGAIN) from error
    pose = _Z_UP @ matrix @ _OPENCV_FROM_OPENGL
    pose[:3, :3] = nearest_rotation(pose[:3, :3])
    return pose


def pinhole(intrinsics: Sequence[float], size: tuple[int, int], field: str) -> CameraModel:
    """The camera model of (fx, fy, cx, cy) in pixels of a photo of `size` (width, height).

    Raises:
        InvalidInputError: no camera has these.
    """
    camera_model = CameraModel("PINHOLE", *size, tuple(intrinsics))
    check_camera_model(camera_model, field=field)
    return camera_model


def numbers(value: Any, count: int, field: str) -> F64:
    """float64 [count] of a list in JSON.

    Raises:
        InvalidInputError: it is no list of so many finite numbers.
    """
    if not isinstance(value, list) or len(value) != count or not all(map(_is_finite, value)):
        raise InvalidInputError(f"{field} is not a list of {count} finite numbers", field=field, hint=_AGAIN)
    return np.array(value, np.float64)


def number(document: Mapping[str, Any], key: str, field: str) -> float:
    """A finite number of a document.

    Raises:
        InvalidInputError: it has none of that name.
    """
    if not _is_finite(document.get(key)):
        raise InvalidInputError(f"{field}: {key} is not a finite number", field=field, hint=_AGAIN)
    return float(document[key])


def pixel_count(document: Mapping[str, Any], key: str, field: str) -> int:
    """A whole number of pixels, 1 to 32768, of a document.

    Raises:
        InvalidInputError: it has none of that name.
    """
    value = number(document, key, field)
    if value != int(value) or not 1 <= value <= 1 << 15:
        raise InvalidInputError(f"{field}: {key} is {value:g} pixels", field=field, hint=_AGAIN)
    return int(value)


def spread(items: Sequence[_Item], settings: CaptureSettings) -> tuple[list[_Item], tuple[str, ...]]:
    """At most `max_phone_frames` of the items, evenly spread, and what people should know of it."""
    limit = settings.max_phone_frames
    if len(items) <= limit:
        return list(items), ()
    rows = np.linspace(0, len(items) - 1, limit).round().astype(int)
    warning = (
        f"{limit} of {len(items)} frames of the recording are used, evenly spread "
        "(FASTSPLAT_CAPTURE__MAX_PHONE_FRAMES)."
    )
    return [items[row] for row in rows], (warning,)


def recording(images: Sequence[PosedImage], field: str, warnings: tuple[str, ...], left_out: LeftOut) -> PosedDataset:
    """The dataset of a recording: metric, with poses that are a tracker's estimates.

    Raises:
        InvalidInputError: it has no images, or none is left.
    """
    if not images:
        raise left_out.refusal(
            InvalidInputError.of(
                field, "has no frame whose photo is in the upload", "Send photos and metadata together."
            )
        )
    points, colors = no_points()
    ordered = tuple(sorted(images, key=lambda image: image.name))
    return PosedDataset(ordered, points, colors, scale="METRIC", tracked=True, warnings=warnings)


def _is_finite(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) < 1e18 and math.isfinite(value)
