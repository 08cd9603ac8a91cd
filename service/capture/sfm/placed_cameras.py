"""What can be shown of a capture while it is made: cameras, and some of the sparse points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.types import Capture
from fastsplat_contract.camera import PosedCamera
from fastsplat_contract.job_watching import PlacedCameras, PlacedInfo
from fastsplat_contract.json_codec import to_json

MAX_CAMERAS, MAX_POINTS = 1_000, 5_000


@dataclass(frozen=True)
class PlacedViews:
    """Cameras that are placed, with some points.

    Attributes:
        cameras: at most `MAX_CAMERAS`.
        points: float32 [P, 3], at most `MAX_POINTS`, scene units.
        colors: uint8 [P, 3], RGB.
        complete: whether these are final; otherwise the world is one of the moment.
    """

    cameras: tuple[PosedCamera, ...]
    points: NDArray[np.float32]
    colors: NDArray[np.uint8]
    placed: int
    images: int
    complete: bool


def thinned(
    cameras: Sequence[PosedCamera],
    points: NDArray[np.floating],
    colors: NDArray[np.uint8],
    images: int,
    *,
    placed: int,
    complete: bool,
) -> PlacedViews:
    """At most `MAX_CAMERAS` of the cameras and `MAX_POINTS` of the points [P, 3], evenly chosen."""
    rows = evenly(len(points), MAX_POINTS)
    return PlacedViews(
        tuple(cameras[row] for row in evenly(len(cameras), MAX_CAMERAS)),
        points[rows].astype(np.float32),
        colors[rows],
        placed,
        images,
        complete,
    )


def placed_of(capture: Capture) -> PlacedViews:
    """The cameras of a finished capture."""
    cameras = [view.posed for view in capture.views]
    images = max(capture.report.images, len(cameras))
    return thinned(cameras, capture.points, capture.point_colors, images, placed=len(cameras), complete=True)


def placed_to_json(placed: PlacedViews) -> bytes:
    """A `PlacedCameras` as it travels, with the number 0: who stores it counts."""
    info = PlacedInfo(0, placed.placed, placed.images, placed.complete)
    points, colors = placed.points.astype("<f4").tobytes(), placed.colors.tobytes()
    return to_json(PlacedCameras(info, placed.cameras, points, colors))


def evenly(count: int, most: int) -> NDArray[np.int64]:
    """Indices of at most `most` of `count`."""
    return np.arange(count) if count <= most else np.linspace(0, count - 1, most).round().astype(np.int64)
