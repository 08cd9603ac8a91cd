"""Selection of the best of a segmenter's masks, and masks to label maps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.results import MaskLogits

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


def select_mask(logits: NDArray[np.float32], quality: NDArray[np.float32], box: NDArray[np.float32]) -> int:
    """Index of the best mask for a box prompt.

    Maximizes the product of predicted IoU, IoU of the mask's own box with the prompt, and stability.

    Args:
        logits: float32 [M, H, W], positive inside.
        quality: float32 [M], predicted IoU.
        box: float32 [4], x1, y1, x2, y2 on the same grid.
    """
    return int(np.argmax([q * box_agreement(x > 0, box) * stability(x) for x, q in zip(logits, quality, strict=True)]))


def best_answers(answer: MaskLogits, boxes: NDArray[np.float32]) -> MaskLogits:
    """Selects the best answer to each box [K, 4] in pixels: [K, 1, h, w]."""
    on_grid = boxes * np.array(answer.scale * 2, np.float32)
    layers = zip(answer.logits, answer.quality, on_grid, strict=True)
    best = np.array([select_mask(logits, quality, box) for logits, quality, box in layers], np.intp)
    rows = np.arange(len(best))
    return MaskLogits(answer.logits[rows, best][:, None], answer.quality[rows, best][:, None], answer.scale)


def stability(logits: NDArray[np.floating[Any]]) -> float:
    """Segment-Anything's stability: IoU of the masks cut at logits +1 and -1."""
    return float((logits > 1).sum() / max(1, (logits > -1).sum()))


def box_agreement(mask: NDArray[np.bool_], box: NDArray[np.floating[Any]]) -> float:
    """IoU of a mask's bounding box with a box [4] in pixels; 0 without mask."""
    columns, rows = np.flatnonzero(mask.any(0)), np.flatnonzero(mask.any(1))
    if not len(columns):
        return 0.0
    bounds = np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], np.float32)
    inner = np.clip(np.minimum(bounds[2:], box[2:]) - np.maximum(bounds[:2], box[:2]), 0, None).prod()
    union = (bounds[2:] - bounds[:2]).prod() + np.clip(box[2:] - box[:2], 0, None).prod() - inner
    return float(inner / max(union, 1e-6))
