"""Computes points of posed images, refines tracked poses, and derives meters from depth sensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import ScaleEstimate, View
from fastsplat.service.capture.formats.depth_maps import F32, inner_pixels, load_depth
from fastsplat.service.capture.formats.image_io import load_rgb
from fastsplat.service.capture.uploads.posed_input import PosedDataset
from fastsplat.service.capture.world.scale_estimates import (
    MOST_DISAGREEMENT,
    TRACKING_ERROR_95,
    depth_ratio,
    scaled_view,
    sensor_estimate,
)
from fastsplat.service.common.file_names import list_names
from fastsplat_contract.errors import ReconstructionError

_DEPTH_POINTS = 5_000  # taken from all depth maps of a capture together, as initial points

PosedTask = Literal["triangulate", "refine"]
SfmAnswer = tuple[dict[str, Any], NDArray[np.float64], NDArray[np.uint8]]
"""Answer of structure from motion, points float64 [P, 3] and colors uint8 [P, 3]."""
RunSfm = Callable[[PosedTask, dict[str, Any]], SfmAnswer]


@dataclass(frozen=True)
class PosedGeometry:
    """Views and points of a posed dataset."""

    views: tuple[View, ...]  # with their final poses
    points: NDArray[np.float32]  # [P, 3], world
    colors: NDArray[np.uint8]  # [P, 3]
    error_px: float  # mean reprojection error of triangulated points; else 0
    scale: ScaleEstimate | None = None  # if meters were measured here
    warnings: tuple[str, ...] = ()


def posed_geometry(
    dataset: PosedDataset, views: tuple[View, ...], images: Path, settings: CaptureSettings, run: RunSfm
) -> PosedGeometry:
    """Computes the geometry of a posed dataset: its own or triangulated points, and depth points.

    Args:
        run: runs a task of structure from motion.

    Raises:
        ReconstructionError: as the task does, or there are too few points.
        ResourceError: as the task does.
    """
    points, colors, error_px = dataset.points, dataset.point_colors, dataset.mean_reprojection_error_px
    warnings: tuple[str, ...] = ()
    if len(points) == 0:
        request = _request(views, images, settings)
        if any(view.depth is not None for view in views):
            request["min_points"] = 0  # plain walls have no features, but the sensor sees them
        result, triangulated, colors = run("refine" if dataset.tracked else "triangulate", request)
        points, error_px = triangulated.astype(np.float32), float(result["error_px"])
        if dataset.tracked:
            views, warnings = _refined(views, result)
    fitted = _fitted(PosedGeometry(views, points, colors, error_px, None, warnings), dataset)
    measured, measured_colors = depth_points(fitted.views, _DEPTH_POINTS)
    if len(fitted.points) + len(measured) < settings.min_points and not len(dataset.points):
        raise ReconstructionError(
            f"only {len(fitted.points)} points agree with the camera poses",
            limit=f"{settings.min_points} points",
            hint="Send sharper photos of objects with texture, or depth maps that have more known pixels.",
        )
    return replace(
        fitted,
        points=np.concatenate([fitted.points, measured]),
        colors=np.concatenate([fitted.colors, measured_colors]),
    )


def _refined(views: tuple[View, ...], result: dict[str, Any]) -> tuple[tuple[View, ...], tuple[str, ...]]:
    """Applies refined poses to the views; also returns warnings for people."""
    poses = {name: np.array(pose, np.float64) for name, pose in result["poses"].items()}
    if not poses:
        reason = f"The tracked poses are used as they are: {result['refused']}."
        return views, (reason,)
    moved = tuple(
        replace(view, posed=replace(view.posed, world_from_camera=poses[view.image_path.name]))
        if view.image_path.name in poses
        else view
        for view in views
    )
    if len(poses) == len(views):
        return moved, ()
    stayed = list_names([view.posed.name for view in views if view.image_path.name not in poses])
    return moved, (
        f"The photos refined {len(poses)} of {len(views)} tracked poses; the others show too few features: {stayed}.",
    )


def _fitted(geometry: PosedGeometry, dataset: PosedDataset) -> PosedGeometry:
    """Unifies the units of poses, points and depths, by exact metric poses or the depths."""
    ratio = depth_ratio(geometry.views, geometry.points)
    tracking = ScaleEstimate("arkit", 1.0, TRACKING_ERROR_95) if dataset.tracked else None
    if ratio is None:
        return replace(geometry, scale=tracking)
    meters_per_unit, standard_error = ratio
    if dataset.scale == "METRIC" and abs(math.log(meters_per_unit)) > MOST_DISAGREEMENT:
        warning = (
            f"The depth maps say that objects are {meters_per_unit:.3g} times as far as the poses say, both in meters; "
            "the depth maps are not used. Check depth_unit_scale_factor."
        )
        views = tuple(replace(view, depth=None) for view in geometry.views)
        return replace(geometry, views=views, scale=tracking, warnings=(*geometry.warnings, warning))
    views = tuple(
        view if view.depth is None else replace(view, depth=replace(view.depth, unit=view.depth.unit / meters_per_unit))
        for view in geometry.views
    )
    if dataset.scale == "METRIC" and not dataset.tracked:
        return replace(geometry, views=views)
    # Tracking is not combined with the sensor, as ARKit uses a LiDAR, too.
    return replace(
        geometry,
        views=tuple(scaled_view(view, meters_per_unit) for view in views),
        points=(geometry.points * np.float32(meters_per_unit)).astype(np.float32),
        scale=sensor_estimate(meters_per_unit, standard_error),
    )


def _request(views: tuple[View, ...], folder: Path, settings: CaptureSettings) -> dict[str, Any]:
    images = []
    for view in views:
        camera = view.posed.camera
        numbers = [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy]
        pose = view.posed.camera_from_world().tolist()
        images.append({"file": view.image_path.name, "camera": numbers, "camera_from_world": pose})
    return {"image_folder": str(folder), "images": images, "ordered": False, **settings.model_dump()}


def depth_points(views: Sequence[View], count: int) -> tuple[F32, NDArray[np.uint8]]:
    """Samples at most `count` colored world points from depth maps, [P, 3] each.

    None on edges, where sensors mix depths. Deterministic, without preferring nearer surfaces.
    """
    measured = [view for view in views if view.depth is not None]
    points, colors = [], []
    for index, view in enumerate(measured):
        assert view.depth is not None
        depth, camera = load_depth(view.depth), view.depth.camera
        rows, columns = np.nonzero(inner_pixels(depth))
        share = count // len(measured) + (index < count % len(measured))
        if len(rows) > share:
            some = np.sort(np.random.default_rng((0, 7, index)).choice(len(rows), share, replace=False))
            rows, columns = rows[some], columns[some]
        rays = camera.rays(columns + 0.5, rows + 0.5)
        x, y = rays[:, 0], rays[:, 1]
        pose, photo_camera = view.posed.world_from_camera, view.posed.camera
        world = (rays * depth[rows, columns, None].astype(np.float64)) @ pose[:3, :3].T + pose[:3, 3]
        at_x = np.floor(x * photo_camera.fx + photo_camera.cx).astype(np.int64)
        at_y = np.floor(y * photo_camera.fy + photo_camera.cy).astype(np.int64)
        inside = (at_x >= 0) & (at_x < photo_camera.width) & (at_y >= 0) & (at_y < photo_camera.height)
        if view.valid_path is not None:
            with Image.open(view.valid_path) as image:
                valid = np.asarray(image.convert("L")) == 255
            inside[inside] = valid[at_y[inside], at_x[inside]]
        points.append(world[inside].astype(np.float32))
        colors.append(load_rgb(view.image_path)[at_y[inside], at_x[inside]])
    if not points:
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8)
    return np.concatenate(points), np.concatenate(colors)
