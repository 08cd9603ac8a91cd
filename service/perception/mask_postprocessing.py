"""Masks to label maps."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

_SPECK = 0.01  # of the mask's area


def clean_mask(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Without specks and pinholes: connected pieces, of the mask and of what it leaves, below 1 % of its area."""
    limit = _SPECK * int(mask.sum())
    return ~_without_small(~_without_small(mask, limit), limit)


def resolve_overlaps(
    masks: NDArray[np.bool_], classes: Sequence[str], weights: NDArray[np.float32], rival_iou: float
) -> list[int]:
    """Rows of bool [K, H, W] to keep: of masks of two classes that overlap by more than `rival_iou` (the same pixels
    under two names), the one with the larger weight. Overlap is intersection over union."""
    areas = masks.sum((1, 2))
    winners: list[int] = []
    for row in np.argsort(-weights, kind="stable"):
        for other in winners:
            if classes[other] != classes[row]:
                shared = int((masks[other] & masks[row]).sum())
                if shared > rival_iou * (areas[other] + areas[row] - shared):
                    break
        else:
            winners.append(int(row))
    return sorted(winners)


def paint(masks: NDArray[np.bool_], ids: Sequence[int], weights: NDArray[np.float32]) -> NDArray[np.uint16]:
    """uint16 [H, W]: where masks overlap, the smallest wins, since an object on or before another shows less of itself;
    of equal ones the heavier.

    Args:
        masks: bool [K, H, W].
        ids: label id of each, from 1.
        weights: float32 [K].
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
