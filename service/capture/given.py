"""What the readers of posed captures have in common."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.labels import LabelTable
from fastsplat.service.capture.lens import Lens
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.scenes import Scale

_ASPECT_SLACK_PX = 1.0


@dataclass(frozen=True)
class GivenPhoto:
    """One image of a posed capture.

    Attributes:
        name: what the view will be called.
        path: the image, relative to the upload.
        lens: as given, for the resolution it was given for.
        world_from_camera: float64 [4, 4], OpenCV axes.
        label_map: path of its label map, if any.
        mask: path of its mask, if any: 0 where pixels are to be ignored.
    """

    name: str
    path: str
    lens: Lens
    world_from_camera: NDArray[np.float64]
    label_map: str | None = None
    mask: str | None = None


@dataclass(frozen=True)
class GivenPoses:
    """A posed capture before its images are touched.

    Attributes:
        photos: sorted by name.
        points: float32 [P, 3], world; may be empty.
        point_colors: uint8 [P, 3].
        scale: whether world units are metres.
        labels: names of the ids in the label maps, if there are any.
        test_names: names of the photos set apart for testing.
        mean_reprojection_error_px: over the points, as far as the source says; else 0.
        warnings: what was left aside, as sentences for people.
    """

    photos: tuple[GivenPhoto, ...]
    points: NDArray[np.float32]
    point_colors: NDArray[np.uint8]
    scale: Scale = "ARBITRARY"
    labels: LabelTable | None = None
    test_names: tuple[str, ...] = ()
    mean_reprojection_error_px: float = 0.0
    warnings: tuple[str, ...] = ()


def no_points() -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Empty points and colours."""
    return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8)


def fits(lens: Lens, width: int, height: int) -> bool:
    """Whether a lens given for its own resolution can be scaled to an image of `width`×`height`: same aspect."""
    scale = (width / lens.width + height / lens.height) / 2
    slack = _ASPECT_SLACK_PX * max(1.0, scale)
    return abs(lens.width * scale - width) <= slack and abs(lens.height * scale - height) <= slack


def wrong_aspect(name: str, lens: Lens, width: int, height: int) -> InvalidInputError:
    """The refusal of intrinsics that cannot be scaled."""
    return InvalidInputError(
        f"{name} has {width}×{height} pixels, its intrinsics are for {lens.width}×{lens.height}: another aspect",
        field=name,
        hint="Send the images that the intrinsics were made for, or a resized, never a cropped or rotated, version.",
    )
