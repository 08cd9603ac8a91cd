"""Writes a capture's views: undistorted, upright, reduced, with masks and label maps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import View
from fastsplat.service.capture.formats.depth_maps import DEPTHS, save_depth
from fastsplat.service.capture.formats.image_io import PhotoInfo, save_rgb
from fastsplat.service.capture.formats.reduced_images import reduced_size
from fastsplat.service.capture.photos.camera_model import (
    CameraModel,
    Undistortion,
    compute_undistortion,
    rotate90,
    rotate90_pose,
)
from fastsplat.service.capture.uploads.posed_input import PosedImage
from fastsplat_contract.geometry.camera import Camera, PosedCamera

IMAGES, MASKS, LABELS = "images", "masks", "labels"


@dataclass(frozen=True)
class SourceImage:
    """An image about to become a view; arrays are upright, of one size, still distorted."""

    name: str
    pixels: NDArray[np.uint8]  # [H, W, 3]
    undistortion: Undistortion
    world_from_camera: NDArray[np.float64]  # [4, 4]
    lossless: bool = False  # storage of the view
    label_ids: NDArray[np.uint16] | None = None  # [H, W], of the dictionary; stored as undetected where masked
    mask: NDArray[np.bool_] | None = None  # [H, W], false where pixels are ignored
    depth: tuple[NDArray[np.float32], Camera] | None = None  # see `view_sources.view_depth`
    exposure_ev: float | None = None
    taken_at: float | None = None


@dataclass(frozen=True)
class WrittenViews:
    """Written views and their label maps, names of wholly masked ones, and warnings."""

    views: tuple[View, ...]
    label_maps: tuple[Path | None, ...]
    masked: tuple[str, ...]
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class ViewGeometry:
    """Geometry of a posed image's view."""

    size: tuple[int, int]  # (width, height) of the reduced upright pixels
    undistortion: Undistortion
    world_from_camera: NDArray[np.float64]  # [4, 4], of the upright view


def view_geometry(posed_image: PosedImage, photo: PhotoInfo, settings: CaptureSettings) -> ViewGeometry:
    """Computes the geometry of a posed image's view as a single pinhole.

    Raises:
        InvalidInputError: the distortion cannot be undone.
    """
    stored, turns, size = reduced_camera(posed_image, photo, settings)
    undistortion = compute_undistortion(stored, settings.max_side, field=posed_image.name)
    return ViewGeometry(
        size=size,
        undistortion=rotate90(undistortion, turns, stored.width, stored.height),
        world_from_camera=rotate90_pose(posed_image.world_from_camera, turns),
    )


def reduced_camera(
    posed_image: PosedImage, photo: PhotoInfo, settings: CaptureSettings
) -> tuple[CameraModel, int, tuple[int, int]]:
    """Computes a posed image's reduced camera, clockwise quarter turns to upright, and upright size.

    Intrinsics are for stored pixels unless their size fits upright ones only.
    """
    stored = posed_image.camera_model
    turns = photo.quarter_turns if stored.fits(photo.width, photo.height) else 0
    size = reduced_size(*photo.upright_size, settings.max_side)
    return stored.scaled_to(*(size if turns % 2 == 0 else size[::-1])), turns, size


def write_view(source: SourceImage, index: int, folder: Path) -> tuple[View, Path | None] | None:
    """Writes a view's files below `folder`; returns it with its label map's path.

    None, and nothing written, if no pixel is valid.
    """
    height, width = source.pixels.shape[:2]
    undistortion = source.undistortion
    valid = undistortion.valid(width, height)
    if source.mask is not None:
        unmasked = undistortion.apply_to_ids(source.mask.astype(np.uint16)) > 0
        valid = unmasked if valid is None else valid & unmasked
    if valid is not None and not valid.any():
        return None
    image_path = folder / IMAGES / f"{index:05d}{'.png' if source.lossless else '.jpg'}"
    save_rgb(undistortion.apply(source.pixels), image_path)
    valid_path = None
    if valid is not None:
        valid_path = folder / MASKS / f"{index:05d}.png"
        Image.fromarray(valid.astype(np.uint8) * 255).save(valid_path)
    label_path = None
    if source.label_ids is not None:
        label_path = folder / LABELS / f"{index:05d}.png"
        label_ids = undistortion.apply_to_ids(source.label_ids)
        Image.fromarray(label_ids if valid is None else np.where(valid, label_ids, np.uint16(0))).save(label_path)
    posed = PosedCamera(undistortion.camera, source.world_from_camera, source.name)
    depth = None
    measured = None if source.depth is None else source.depth[0]
    if source.depth is not None and valid is not None:
        measured = _valid_depth(*source.depth, valid, undistortion.camera)
    if source.depth is not None and measured is not None and measured.any():
        depth = save_depth(measured, source.depth[1], folder / DEPTHS / f"{index:05d}.png")
    view = View(posed, image_path, valid_path, depth, source.exposure_ev, source.taken_at, undistortion.lens)
    return view, label_path


def _valid_depth(
    depth: NDArray[np.float32], source: Camera, valid: NDArray[np.bool_], target: Camera
) -> NDArray[np.float32]:
    """Drops depths that overlap invalid pixels [H', W'] of `target` at the same place.

    Withheld pixels thus have no depth.
    """
    columns = (np.arange(source.width) + 0.5 - source.cx) / source.fx * target.fx + target.cx
    rows = (np.arange(source.height) + 0.5 - source.cy) / source.fy * target.fy + target.cy
    half = [max(1, math.ceil(0.5 * t / s + 0.5)) for t, s in ((target.fx, source.fx), (target.fy, source.fy))]
    kernel = np.ones((2 * half[1] + 1, 2 * half[0] + 1), np.uint8)
    whole = cv2.erode(valid.astype(np.uint8), kernel, borderType=cv2.BORDER_REPLICATE) > 0
    x = np.clip(np.floor(columns).astype(np.int64), 0, target.width - 1)
    y = np.clip(np.floor(rows).astype(np.int64), 0, target.height - 1)
    return np.where(whole[np.ix_(y, x)], depth, np.float32(0))
