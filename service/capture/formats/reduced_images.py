"""Reduces images to a size."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def reduced_size(width: int, height: int, max_side: int) -> tuple[int, int]:
    """Limits the longer side to `max_side`."""
    scale = min(1.0, max_side / max(width, height))
    return max(1, round(width * scale)), max(1, round(height * scale))


def reduce(pixels: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Averages uint8 [H, W, ...] down to `size` (width, height)."""
    if pixels.shape[1::-1] == size:
        return pixels
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def limited(pixels: NDArray[np.uint8], side: int) -> NDArray[np.uint8]:
    """Reduces uint8 [H, W, ...] to at most `side` pixels on its longer side."""
    return reduce(pixels, reduced_size(pixels.shape[1], pixels.shape[0], side))


def reduce_ids(ids: NDArray[np.uint16], size: tuple[int, int]) -> NDArray[np.uint16]:
    """Samples ids [H, W] down to `size` (width, height) by nearest neighbor."""
    if ids.shape[1::-1] == size:
        return ids
    return np.asarray(cv2.resize(ids, size, interpolation=cv2.INTER_NEAREST_EXACT), dtype=np.uint16)
