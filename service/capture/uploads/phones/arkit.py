"""Shared parts of ARKit recordings: axes, intrinsics, and checked JSON values.

ARKit's world has y up and meters; its cameras have x right, y up, z backward. Ours has z up and OpenCV cameras.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.bounded_json import read_json
from fastsplat.service.capture.formats.depth_files import DepthFile
from fastsplat.service.capture.photos.camera_model import CameraModel, check_camera_model
from fastsplat.service.capture.uploads.left_out import LeftOut
from fastsplat.service.capture.uploads.posed_input import PosedDataset, PosedImage, check_position, no_points
from fastsplat.service.common.similarity import nearest_rotation
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import OPENCV_FROM_OPENGL, check_rigid

_Z_UP = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
_AGAIN = "Export the recording again."
_Item = TypeVar("_Item")

F64 = NDArray[np.float64]


def json_object(root: Path, path: str, settings: CaptureSettings) -> dict[str, Any]:
    """Reads a JSON object; raises `InvalidInputError` for another value, and as `read_json`."""
    document = read_json(root / path, path, settings)
    if not isinstance(document, dict):
        raise InvalidInputError(f"{path} is not a JSON object", field=path, hint=_AGAIN)
    return document


def depth_file(
    root: Path, maps: Iterable[PurePosixPath], unit: float = 0.001, size: tuple[int, int] | None = None
) -> DepthFile | None:
    """Finds a depth map, by default in millimeters, and its confidence map; None without a depth map."""
    depth, confidence = maps
    if not (root / depth).is_file():
        return None
    return DepthFile(str(depth), unit, size, str(confidence) if (root / confidence).is_file() else None)


def world_from_camera(matrix: F64, field: str) -> F64:
    """Converts ARKit's camera transform to z up and OpenCV axes; raises `InvalidInputError` unless rigid."""
    try:
        check_rigid(matrix, field=field)
        check_position(matrix, field)
    except InvalidInputError as error:
        raise InvalidInputError(error.message, field=field, hint=_AGAIN) from error
    pose = _Z_UP @ matrix @ OPENCV_FROM_OPENGL
    pose[:3, :3] = nearest_rotation(pose[:3, :3])
    return pose


def pinhole(intrinsics: Sequence[float], size: tuple[int, int], field: str) -> CameraModel:
    """Makes a checked camera model from (fx, fy, cx, cy), pixels of `size` (width, height)."""
    camera_model = CameraModel("PINHOLE", *size, tuple(intrinsics))
    check_camera_model(camera_model, field=field)
    return camera_model


def numbers(value: Any, count: int, field: str) -> F64:
    """Reads a JSON list as float64 [count]; raises `InvalidInputError` unless finite and complete."""
    if not isinstance(value, list) or len(value) != count or not all(map(_is_finite, value)):
        raise InvalidInputError(f"{field} is not a list of {count} finite numbers", field=field, hint=_AGAIN)
    return np.array(value, np.float64)


def number(document: Mapping[str, Any], key: str, field: str) -> float:
    """Reads a finite number; raises `InvalidInputError` without one."""
    if not _is_finite(document.get(key)):
        raise InvalidInputError(f"{field}: {key} is not a finite number", field=field, hint=_AGAIN)
    return float(document[key])


def pixel_count(document: Mapping[str, Any], key: str, field: str) -> int:
    """Reads a whole number of pixels, 1 to 32768; raises `InvalidInputError` without one."""
    value = number(document, key, field)
    if value != int(value) or not 1 <= value <= 1 << 15:
        raise InvalidInputError(f"{field}: {key} is {value:g} pixels", field=field, hint=_AGAIN)
    return int(value)


def spread(items: Sequence[_Item], settings: CaptureSettings) -> tuple[list[_Item], tuple[str, ...]]:
    """Thins items evenly to `max_phone_frames`; also returns warnings for people."""
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
    """Makes the metric dataset of a tracked recording; raises `InvalidInputError` without images."""
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
