"""Depth maps of a sensor as a capture holds them: upright, undistorted, with a pinhole camera of their own resolution.

A map keeps its own pixels, because blowing up 256×192 measurements to a photo's size would put values where nothing was
measured.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from fastsplat.service.capture.formats.depth_files import DepthFile
from fastsplat.service.capture.formats.depth_maps import F32
from fastsplat.service.capture.formats.image_io import PhotoInfo
from fastsplat.service.capture.photos.camera_model import compute_undistortion, rotate90
from fastsplat.service.capture.untrusted.image_decoder import ImageDecoder
from fastsplat.service.capture.uploads.posed_input import PosedImage
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
) -> tuple[F32, Camera]:
    """A depth map float32 [H, W] of a posed image's view, scene units, 0 where unknown, and its pinhole camera.

    Args:
        image: the image, whose camera model is for the photo as stored.
        file: its depth map, which covers what the photo covers, in the orientation of the photo as stored.
        stored_size: (width, height) of the map.
        photo: the photo.
        decoder: reads the map.
        root: the upload's files.

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
