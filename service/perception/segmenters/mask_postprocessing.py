"""Masks to label maps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

_SPECK = 0.01  # of the mask's area


def clean_mask(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Removes specks and pinholes: connected pieces below 1 % of the mask's area."""
    limit = _SPECK * int(mask.sum())
    return ~_without_small(~_without_small(mask, limit), limit)


def upsampled(
    logits: NDArray[np.floating[Any]], scale: tuple[float, float], size: tuple[int, int], width: int, height: int
) -> NDArray[np.bool_]:
    """Resizes masks of a segmenter's grid, with interpolated edges, to bool [K, height, width].

    Args:
        logits: [K, h, w], positive inside.
        scale: grid steps per pixel of the image, along x and y.
        size: height and width of the image.
    """
    # The center of pixel x of the resized image is at (x + 0.5)·step on the grid, whose first center is at 0.5.
    step_x, step_y = scale[0] * size[1] / width, scale[1] * size[0] / height
    to_grid = np.array([[step_x, 0, step_x / 2 - 0.5], [0, step_y, step_y / 2 - 0.5]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    result = np.zeros((len(logits), height, width), np.bool_)
    for row, layer in enumerate(logits):
        full = cv2.warpAffine(
            layer.astype(np.float32), to_grid, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE
        )
        result[row] = full > 0
    return result


def resolve_overlaps(
    masks: NDArray[np.bool_], classes: Sequence[str], weights: NDArray[np.float32], rival_iou: float
) -> list[int]:
    """Rows of masks [K, H, W] to keep: the heavier of rivals.

    Rivals are masks of two classes with an intersection over union above `rival_iou`.
    """
    areas = masks.sum((1, 2))
    winners: list[int] = []
    for row in np.argsort(-weights, kind="stable"):
        for winner in winners:
            if classes[winner] != classes[row]:
                shared = int((masks[winner] & masks[row]).sum())
                if shared > rival_iou * (areas[winner] + areas[row] - shared):
                    break
        else:
            winners.append(int(row))
    return sorted(winners)


def paint(masks: NDArray[np.bool_], ids: Sequence[int], weights: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Paints masks [K, H, W] into a label map, the smallest (or heaviest) on top.

    An object on or before another shows less of itself. `ids` count from 1.
    """
    label_map = np.zeros(masks.shape[1:], np.uint16)
    areas = masks.sum((1, 2))
    for row in sorted(range(len(ids)), key=lambda i: (-areas[i], weights[i])):
        label_map[masks[row]] = ids[row]
    return label_map


def _without_small(mask: NDArray[np.bool_], limit: float) -> NDArray[np.bool_]:
    count, pieces, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    keep = stats[:, cv2.CC_STAT_AREA] >= limit
    keep[0] = False
    return np.asarray(keep[pieces]) if count > 1 else mask
