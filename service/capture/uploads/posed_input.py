"""Posed images of all readers, and their shared checks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.depth_files import DepthFile
from fastsplat.service.capture.photos.camera_model import CameraModel
from fastsplat.service.capture.uploads.label_maps import LabelTable
from fastsplat.service.common.file_names import list_names
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.messages.scenes import Scale

_FARTHEST = 1e7
"""World units; in meters, more than from any place on Earth to its center."""
_RIGID = 1e-3


@dataclass(frozen=True)
class PosedImage:
    """An image of a posed dataset."""

    name: str  # of its view
    path: str  # in the upload
    camera_model: CameraModel  # for the resolution in the document
    world_from_camera: NDArray[np.float64]  # [4, 4], OpenCV axes
    label_map: str | None = None  # path
    mask: str | None = None  # path; 0 where pixels are ignored
    depth: DepthFile | None = None


@dataclass(frozen=True)
class MissingImage:
    """An image that has a pose, but is not in the upload."""

    name: str  # of its view
    path: str  # expected in the upload; without extension if the document gives none


@dataclass(frozen=True)
class PosedDataset:
    """Images with cameras and poses before a pixel is read."""

    images: tuple[PosedImage, ...]  # sorted by name
    points: NDArray[np.float32]  # [P, 3], world; may be empty
    point_colors: NDArray[np.uint8]  # [P, 3]
    scale: Scale = "ARBITRARY"
    labels: LabelTable | None = None  # of the label maps
    test_names: tuple[str, ...] = ()  # images reserved for testing
    mean_reprojection_error_px: float = 0.0  # 0 if unknown
    missing: tuple[MissingImage, ...] = ()
    warnings: tuple[str, ...] = ()  # sentences for people about what is not used
    tracked: bool = False  # poses are a phone's estimates, to be refined; otherwise exact


def missing_warning(
    field: str, missing: Sequence[MissingImage], frames: int, settings: CaptureSettings
) -> tuple[str, ...]:
    """Warns about missing images; raises `InvalidInputError` below `min_frames_present`."""
    if not missing:
        return ()
    listed = list_names([image.name for image in missing])
    present = frames - len(missing)
    if present == 0 or present < settings.min_frames_present * frames:
        raise InvalidInputError(
            f"{len(missing)} of {frames} frames of {field} name images that are not in the upload: {listed}",
            field=field,
            limit=f"a share of {settings.min_frames_present:g} of the images",
            hint="Send the images under the names that file_path gives them.",
        )
    return (f"{len(missing)} of {frames} frames of {field} are skipped, as their images are missing: {listed}.",)


def check_position(pose: NDArray[np.float64], field: str) -> None:
    """Raises `InvalidInputError` if a camera is too far from the origin, in world units."""
    distance = float(np.abs(pose[:3, 3]).max())
    if distance > _FARTHEST:
        raise InvalidInputError.of(
            field,
            f": the camera is {distance:.3g} units from the origin",
            "Move the origin to the scene, or remove the frame.",
            f"{_FARTHEST:g} units",
        )


def stated_similarity(
    document: Mapping[str, Any], names: tuple[str, str], field: str, hint: str
) -> tuple[NDArray[np.float64], float]:
    """Reads a rigid transform [4, 4] and a positive scale by name, or raises `InvalidInputError`."""
    result = np.eye(4)
    try:
        result[:3] = np.array(document[names[0]], dtype=np.float64)[:3]
        scale = float(document[names[1]])
    except (TypeError, ValueError, KeyError, IndexError, OverflowError):
        scale = 0.0
    rotation = result[:3, :3]
    is_rigid = np.isfinite(result).all() and np.abs(rotation @ rotation.T - np.eye(3)).max() < _RIGID
    if not is_rigid or not np.isfinite(scale) or scale <= 0:
        raise InvalidInputError.of(field, f"has no rigid {names[0]} of 3×4 numbers with a positive {names[1]}", hint)
    return result, scale


def no_points() -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Makes empty points and colors."""
    return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8)


def mask_warning(dataset: PosedDataset) -> tuple[str, ...]:
    """Makes a sentence for people about masks in a dataset without labels, if any."""
    masked = sum(image.mask is not None for image in dataset.images)
    text = f"{masked} images have a mask: pixels that are 0 in it are ignored. Label maps need labels for their ids."
    return (text,) if masked else ()
