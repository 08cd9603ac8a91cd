"""Selection of the best of a segmenter's masks."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.results import MaskLogits


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
