"""Cameras and sparse points of a capture in progress, for display."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.captures import Capture
from fastsplat_contract.codec.json_codec import to_json
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.jobs.job_watching import PlacedCameras, PlacedInfo

MAX_CAMERAS, MAX_POINTS = 1_000, 5_000


@dataclass(frozen=True)
class PlacedViews:
    """Placed cameras with some points."""

    cameras: tuple[PosedCamera, ...]  # at most `MAX_CAMERAS`
    points: NDArray[np.float32]  # [P, 3], at most `MAX_POINTS`, scene units
    colors: NDArray[np.uint8]  # [P, 3], RGB
    placed: int
    images: int
    complete: bool  # final; otherwise the world may still change


def thinned(
    cameras: Sequence[PosedCamera],
    points: NDArray[np.floating],
    colors: NDArray[np.uint8],
    images: int,
    *,
    placed: int,
    complete: bool,
) -> PlacedViews:
    """Thins cameras and points [P, 3] evenly to `MAX_CAMERAS` and `MAX_POINTS`."""
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
    """Makes the placed views of a finished capture."""
    cameras = [view.posed for view in capture.views]
    images = max(capture.report.images, len(cameras))
    return thinned(cameras, capture.points, capture.point_colors, images, placed=len(cameras), complete=True)


def placed_to_json(placed: PlacedViews) -> bytes:
    """Encodes `PlacedCameras` with number 0, which the store replaces."""
    info = PlacedInfo(0, placed.placed, placed.images, placed.complete)
    points, colors = placed.points.astype("<f4").tobytes(), placed.colors.tobytes()
    return to_json(PlacedCameras(info, placed.cameras, points, colors))


def evenly(count: int, most: int) -> NDArray[np.int64]:
    """Chooses at most `most` evenly spread indices of `count`."""
    return np.arange(count) if count <= most else np.linspace(0, count - 1, most).round().astype(np.int64)
