"""Writes a capture's views: undistorted, upright, reduced, with whatever masks and label maps belong to them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.capture.given import GivenPhoto, fits
from fastsplat.service.capture.images import PhotoInfo, open_map, save_rgb, turn
from fastsplat.service.capture.lens import Undistortion, turned, turned_pose, undistortion
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.capture.types import View
from fastsplat_contract.camera import PosedCamera

IMAGES, MASKS, LABELS = "images", "masks", "labels"


@dataclass(frozen=True)
class Shot:
    """One image about to become a view; all arrays upright, of one size, still distorted.

    Attributes:
        name: of the view.
        pixels: uint8 [H, W, 3].
        way: how to undistort them.
        world_from_camera: float64 [4, 4].
        lossless: whether the view is stored without loss.
        ids: uint16 [H, W] of the dictionary, or None.
        mask: bool [H, W], false where pixels are to be ignored, or None.
    """

    name: str
    pixels: NDArray[np.uint8]
    way: Undistortion
    world_from_camera: NDArray[np.float64]
    lossless: bool = False
    ids: NDArray[np.uint16] | None = None
    mask: NDArray[np.bool_] | None = None


@dataclass(frozen=True)
class Placement:
    """How a posed photo becomes a view.

    Attributes:
        size: (width, height) that its upright pixels are reduced to.
        way: how to undistort them then.
        world_from_camera: float64 [4, 4] of the upright view.
    """

    size: tuple[int, int]
    way: Undistortion
    world_from_camera: NDArray[np.float64]


def placement(given: GivenPhoto, photo: PhotoInfo, settings: CaptureSettings) -> Placement:
    """Intrinsics are for the pixels as stored, as COLMAP reads them, unless their size fits upright ones only.

    Raises:
        InvalidInputError: the lens's distortion cannot be undone.
    """
    turns = photo.quarter_turns if fits(given.lens, photo.width, photo.height) else 0
    size = reduced_size(*photo.upright_size, settings.max_side)
    width, height = size if turns % 2 == 0 else size[::-1]
    way = undistortion(given.lens.scaled_to(width, height), settings.max_side, field=given.name)
    return Placement(size, turned(way, turns, width, height), turned_pose(given.world_from_camera, turns))


def load_upright_map(
    root: Path, name: str, photo: PhotoInfo, size: tuple[int, int], settings: CaptureSettings
) -> NDArray[np.uint16]:
    """uint16 [H, W] of a stored map, reduced to `size`.

    A map drawn on the upright image stays; one of another size was drawn on the stored pixels.
    """
    stored = open_map(root, name, settings)
    if stored.shape[1::-1] != photo.upright_size:
        stored = turn(stored, photo.orientation)
    return reduce_ids(stored, size)


def write_view(shot: Shot, index: int, folder: Path) -> tuple[View, Path | None]:
    """Write the view's files below `folder`; returns the view and its label map's path."""
    height, width = shot.pixels.shape[:2]
    valid = shot.way.valid(width, height)
    if shot.mask is not None:
        kept = shot.way.apply_to_ids(shot.mask.astype(np.uint16)) > 0
        valid = kept if valid is None else valid & kept
    image_path = folder / IMAGES / f"{index:05d}{'.png' if shot.lossless else '.jpg'}"
    save_rgb(shot.way.apply(shot.pixels), image_path)
    valid_path = None
    if valid is not None:
        valid_path = folder / MASKS / f"{index:05d}.png"
        Image.fromarray(valid.astype(np.uint8) * 255).save(valid_path)
    label_path = None
    if shot.ids is not None:
        label_path = folder / LABELS / f"{index:05d}.png"
        Image.fromarray(shot.way.apply_to_ids(shot.ids)).save(label_path)
    posed = PosedCamera(shot.way.camera, shot.world_from_camera, shot.name)
    return View(posed, image_path, valid_path), label_path


def reduced_size(width: int, height: int, max_side: int) -> tuple[int, int]:
    """(width, height) with the longer side at most `max_side`."""
    scale = min(1.0, max_side / max(width, height))
    return max(1, round(width * scale)), max(1, round(height * scale))


def reduce(pixels: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """uint8 [H, W, 3] averaged down to `size` (width, height)."""
    if pixels.shape[1::-1] == size:
        return pixels
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def reduce_ids(ids: NDArray[np.uint16], size: tuple[int, int]) -> NDArray[np.uint16]:
    """uint16 [H, W] sampled down to `size` (width, height), nearest neighbour."""
    if ids.shape[1::-1] == size:
        return ids
    return np.asarray(cv2.resize(ids, size, interpolation=cv2.INTER_NEAREST_EXACT), dtype=np.uint16)
