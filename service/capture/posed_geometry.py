"""Points of images whose poses are known, from what the upload brought, what they show, and what a sensor measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.posed_input import PosedDataset
from fastsplat.service.capture.sensor_depth import depth_points
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.capture.types import ScaleEstimate, View

PosedTask = Literal["triangulate"]
SfmAnswer = tuple[dict[str, Any], NDArray[np.float64], NDArray[np.uint8]]
"""What a task of structure from motion answers, its points float64 [P, 3] and their colors uint8 [P, 3]."""
RunSfm = Callable[[PosedTask, dict[str, Any]], SfmAnswer]


@dataclass(frozen=True)
class PosedGeometry:
    """Views and the points that they show.

    Attributes:
        views: as they were written, with the poses that are to be used.
        points: float32 [P, 3], world.
        colors: uint8 [P, 3].
        error_px: mean reprojection error of triangulated points; else 0.
        scale: what the metres rest on, where they were measured here.
        warnings: sentences for people.
    """

    views: tuple[View, ...]
    points: NDArray[np.float32]
    colors: NDArray[np.uint8]
    error_px: float
    scale: ScaleEstimate | None = None
    warnings: tuple[str, ...] = ()


def posed_geometry(
    dataset: PosedDataset, views: tuple[View, ...], images: Path, settings: CaptureSettings, run: RunSfm
) -> PosedGeometry:
    """The geometry of a posed dataset: its own points, or else triangulated ones; and points of the depth maps.

    Args:
        dataset: as read from the upload.
        views: written of it.
        images: folder of their images.
        settings: `depth_points`, and those of structure from motion.
        run: runs a task of structure from motion.

    Raises:
        ReconstructionError, ResourceError: as the task does.
    """
    points, colors, error_px = dataset.points, dataset.point_colors, dataset.mean_reprojection_error_px
    measured, measured_colors = depth_points(views, settings.depth_points)
    if len(points) == 0:
        request = _request(views, images, settings)
        if len(measured) >= settings.min_points:
            request["min_points"] = 0  # plain walls have no features, but the sensor sees them
        result, triangulated, colors = run("triangulate", request)
        points, error_px = triangulated.astype(np.float32), float(result["error_px"])
    points, colors = np.concatenate([points, measured]), np.concatenate([colors, measured_colors])
    return PosedGeometry(views, points, colors, error_px)


def _request(views: tuple[View, ...], folder: Path, settings: CaptureSettings) -> dict[str, Any]:
    images = []
    for view in views:
        camera = view.posed.camera
        numbers = [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy]
        pose = view.posed.camera_from_world().tolist()
        images.append({"file": view.image_path.name, "camera": numbers, "camera_from_world": pose})
    return {"image_folder": str(folder), "images": images, "ordered": False, **settings.model_dump()}
