"""Box arithmetic: float32 [K, 4], x1, y1, x2, y2 in pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Boxes = NDArray[np.float32]


def box_iou(first: Boxes, second: Boxes) -> NDArray[np.float32]:
    """float32 [A, B]: intersection over union of every pair; 0 where both are empty."""
    corner = np.maximum(first[:, None, :2], second[None, :, :2])
    opposite = np.minimum(first[:, None, 2:], second[None, :, 2:])
    intersection = np.clip(opposite - corner, 0, None).prod(-1)
    area_first = np.clip(first[:, 2:] - first[:, :2], 0, None).prod(-1)
    area_second = np.clip(second[:, 2:] - second[:, :2], 0, None).prod(-1)
    union = area_first[:, None] + area_second[None] - intersection
    return np.asarray(intersection / np.maximum(union, np.finfo(np.float32).tiny), np.float32)


def nms(boxes: Boxes, scores: NDArray[np.float32], iou: float) -> NDArray[np.intp]:
    """Greedy non-maximum suppression: rows to keep, best first; ties go to the earlier row."""
    overlaps = box_iou(boxes, boxes)
    winners: list[int] = []
    for row in np.argsort(-scores, kind="stable"):
        if all(overlaps[row, winner] <= iou for winner in winners):
            winners.append(int(row))
    return np.asarray(winners, dtype=np.intp)


def clip_boxes(boxes: Boxes, width: int, height: int) -> Boxes:
    """Clips boxes to an image."""
    limit = np.array([width, height, width, height], np.float32)
    return np.clip(boxes, 0, limit).astype(np.float32)
