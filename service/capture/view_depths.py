"""Depth maps of a sensor as a capture holds them: upright, undistorted, with a pinhole camera of their own resolution.

A map keeps its own pixels, because blowing up 256×192 measurements to a photo's size would put values where nothing was
measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.capture.camera_model import compute_undistortion, rotate90
from fastsplat.service.capture.depth_files import DepthFile
from fastsplat.service.capture.depth_maps import F32, inner_pixels, load_depth
from fastsplat.service.capture.image_decoder import ImageDecoder
from fastsplat.service.capture.image_io import PhotoInfo, load_rgb
from fastsplat.service.capture.posed_input import PosedImage
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.capture.types import View
from fastsplat_contract.camera import Camera

MAX_SIDE = 640
"""Pixels of a stored map's longer side at most; trainings do not look at photos more closely."""


def view_depth(
    image: PosedImage,
    file: DepthFile,
    stored_size: tuple[int, int],
    photo: PhotoInfo,
    decoder: ImageDecoder,
    root: Path,
    settings: CaptureSettings,
) -> tuple[F32, Camera]:
    """A depth map float32 [H, W] of a posed image's view, scene units, 0 where unknown, and its pinhole camera.

    Args:
        image: the image, whose camera model is for the photo as stored.
        file: its depth map, which covers what the photo covers, in the orientation of the photo as stored.
        stored_size: (width, height) of the map.
        photo: the photo.
        decoder: reads the map.
        root: the upload's files.
        settings: limits.

    Raises:
        CorruptImageError, LimitExceededError, ResourceError: as `ImageDecoder.photo`.
    """
    scale = min(1.0, MAX_SIDE / max(stored_size))
    width, height = (max(1, round(side * scale)) for side in stored_size)
    depth = decoder.depth(root, file, photo, (width, height))
    turns = photo.quarter_turns if image.camera_model.fits(photo.width, photo.height) else 0
    undistortion = compute_undistortion(image.camera_model.scaled_to(width, height), MAX_SIDE, field=image.name)
    undistortion = rotate90(undistortion, turns, width, height)
    depth = np.ascontiguousarray(np.rot90(depth, -turns))
    if undistortion.map_xy is not None:
        x, y = undistortion.map_xy[..., 0], undistortion.map_xy[..., 1]
        depth = np.asarray(cv2.remap(depth, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT))
    return depth, undistortion.camera


def depth_points(views: Sequence[View], count: int) -> tuple[F32, NDArray[np.uint8]]:
    """At most `count` points float32 [P, 3] on what the depth maps of the views show, world, and their colors uint8
    [P, 3] by the photos; none on edges, where sensors mix what is in front with what is behind.

    The same views give the same points. A pixel of a farther surface stands for a larger one: the nearer ones are not
    preferred.
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
        shown = (at_x >= 0) & (at_x < photo_camera.width) & (at_y >= 0) & (at_y < photo_camera.height)
        if view.valid_path is not None:
            with Image.open(view.valid_path) as image:
                valid = np.asarray(image.convert("L")) == 255
            shown[shown] = valid[at_y[shown], at_x[shown]]
        points.append(world[shown].astype(np.float32))
        colors.append(load_rgb(view.image_path)[at_y[shown], at_x[shown]])
    if not points:
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8)
    return np.concatenate(points), np.concatenate(colors)
