"""Posed images as the COLMAP and nerfstudio readers return them, and what both readers need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.formats.depth_files import DepthFile
from fastsplat.service.capture.photos.camera_model import CameraModel
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.capture.uploads.label_maps import LabelTable
from fastsplat.service.common.file_names import list_names
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.scenes import Scale

_FARTHEST = 1e7
"""World units; in meters, farther than any place on Earth is from its center."""
_RIGID = 1e-3


@dataclass(frozen=True)
class PosedImage:
    """One image of a posed dataset.

    Attributes:
        name: what the view will be called.
        path: the image, relative to the upload.
        camera_model: as stored, for the resolution that it was stored for.
        world_from_camera: float64 [4, 4], OpenCV axes.
        label_map: path of its label map, if any.
        mask: path of its mask, if any: 0 where pixels are to be ignored.
    """

    name: str
    path: str
    camera_model: CameraModel
    world_from_camera: NDArray[np.float64]
    label_map: str | None = None
    mask: str | None = None
    depth: DepthFile | None = None


@dataclass(frozen=True)
class MissingImage:
    """An image that has a pose, but is not in the upload.

    Attributes:
        name: what the view would be called.
        path: where the image would be, relative to the upload; without extension if the document gives none.
    """

    name: str
    path: str


@dataclass(frozen=True)
class PosedDataset:
    """Images with cameras and poses before a pixel is read.

    Attributes:
        images: sorted by name.
        points: float32 [P, 3], world; may be empty.
        point_colors: uint8 [P, 3].
        scale: whether world units are meters.
        tracked: whether the poses are estimates of a phone's tracking, which the images refine; else they are exact.
        labels: names of the ids in the label maps, if there are any.
        test_names: names of the images set apart for testing.
        mean_reprojection_error_px: over the points, as far as the source says; else 0.
        missing: images that have a pose, but are not there.
        warnings: what is not used, as sentences for people.
    """

    images: tuple[PosedImage, ...]
    points: NDArray[np.float32]
    point_colors: NDArray[np.uint8]
    scale: Scale = "ARBITRARY"
    labels: LabelTable | None = None
    test_names: tuple[str, ...] = ()
    mean_reprojection_error_px: float = 0.0
    missing: tuple[MissingImage, ...] = ()
    warnings: tuple[str, ...] = ()
    tracked: bool = False


def missing_warning(
    field: str, missing: Sequence[MissingImage], frames: int, settings: CaptureSettings
) -> tuple[str, ...]:
    """What to say of frames whose image is not in the upload.

    Raises:
        InvalidInputError: fewer than `min_frames_present` are there.
    """
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
    """Raise `InvalidInputError` unless a camera's position (the pose's last column, world units) is within reach."""
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
    """The rigid part float64 [4, 4] and the scale that a document states under these names.

    Raises:
        InvalidInputError: they are no rigid 3×4 matrix and no positive number.
    """
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
    """Empty points and colors."""
    return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8)


def mask_warning(dataset: PosedDataset) -> tuple[str, ...]:
    """A sentence for people about masks in a data set without labels; none if it has no masks."""
    masked = sum(image.mask is not None for image in dataset.images)
    text = f"{masked} images have a mask: pixels that are 0 in it are ignored. Label maps need labels for their ids."
    return (text,) if masked else ()
