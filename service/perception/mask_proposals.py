"""Masks of whatever is in an image, without a name or a vocabulary: the answers of a segmenter that it is sure of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.perception.types import MaskLogits


@dataclass(frozen=True)
class MaskProposals:
    """P masks of one image that may overlap: parts, things and groups of things.

    Attributes:
        logits: float16 [P, h, w], positive inside, on the segmenter's grid, which covers the image and no more.
        quality: float32 [P], predicted intersection over union times stability, 0..1.
        scale: steps of the grid a pixel of the image, along x and y.
        size: height and width of the image.
    """

    logits: NDArray[np.float16]
    quality: NDArray[np.float32]
    scale: tuple[float, float]
    size: tuple[int, int]

    def __post_init__(self) -> None:
        assert self.logits.ndim == 3 and self.logits.dtype == np.float16
        assert self.quality.shape == (len(self.logits),) and self.quality.dtype == np.float32

    def __len__(self) -> int:
        return len(self.quality)

    def take(self, rows: Sequence[int] | NDArray[np.integer]) -> MaskProposals:
        """Those of these rows, in this order."""
        index = np.asarray(rows, np.intp)
        return MaskProposals(self.logits[index], self.quality[index], self.scale, self.size)

    def masks(self, width: int, height: int) -> NDArray[np.bool_]:
        """bool [P, height, width]: the masks for the image at this size, edges interpolated between grid steps."""
        # Pixel x of the resized image has its center at (x + 0.5)·step on the grid, whose first center is at 0.5.
        step_x = self.scale[0] * self.size[1] / width
        step_y = self.scale[1] * self.size[0] / height
        to_grid = np.array([[step_x, 0, step_x / 2 - 0.5], [0, step_y, step_y / 2 - 0.5]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        result = np.zeros((len(self), height, width), np.bool_)
        for row, layer in enumerate(self.logits):
            full = cv2.warpAffine(
                layer.astype(np.float32), to_grid, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE
            )
            result[row] = full > 0
        return result


def grid_points(width: int, height: int, across: int) -> NDArray[np.float64]:
    """float64 [K, 2] x and y of a regular grid over an image, `across` points along its longer side."""
    step = max(width, height) / across
    columns, rows = (max(1, round(side / step)) for side in (width, height))
    x, y = (np.arange(columns) + 0.5) * width / columns, (np.arange(rows) + 0.5) * height / rows
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def sure_proposals(answer: MaskLogits, size: tuple[int, int], settings: PerceptionSettings) -> MaskProposals:
    """The answers that the segmenter predicts to be good, that are stable and that are no specks.

    The stability score is Segment-Anything's: the intersection over union of the masks cut at logits +1 and -1.

    Args:
        answer: to K prompts, M masks each.
        size: height and width of the image.
        settings: `proposal_quality`, `proposal_stability` and `min_pixels`.
    """
    grid = answer.logits.shape[2:]
    area = (answer.logits > 0).sum(axis=(2, 3)) / (answer.scale[0] * answer.scale[1])
    inner = (answer.logits > 1).sum(axis=(2, 3))
    stability = inner / np.maximum((answer.logits > -1).sum(axis=(2, 3)), 1)
    sure = (answer.quality > settings.proposal_quality) & (stability > settings.proposal_stability)
    sure &= area >= settings.min_pixels
    logits = answer.logits[sure].reshape(-1, *grid)
    quality = (answer.quality * stability)[sure]
    return MaskProposals(np.clip(logits, -100, 100).astype(np.float16), quality.astype(np.float32), answer.scale, size)


def joined_proposals(parts: Sequence[MaskProposals]) -> MaskProposals:
    """All proposals of several rounds of prompts on one image; at least one part."""
    logits = np.concatenate([part.logits for part in parts])
    return MaskProposals(logits, np.concatenate([part.quality for part in parts]), parts[0].scale, parts[0].size)


def distinct_proposals(proposals: MaskProposals, max_overlap: float) -> MaskProposals:
    """The best of every set of proposals that are the same mask: by descending quality, those whose intersection over
    union with each one before is at most `max_overlap` (non-maximum suppression)."""
    if not len(proposals):
        return proposals
    order = np.argsort(-proposals.quality, kind="stable")
    flat = (proposals.logits[order] > 0).reshape(len(order), -1).astype(np.float32)
    common = flat @ flat.T
    areas = flat.sum(axis=1)
    double = common > max_overlap * (areas[:, None] + areas - common)
    free, winners = np.ones(len(order), np.bool_), []
    for row in range(len(order)):
        if free[row]:
            winners.append(row)
            free &= ~double[row]
    return proposals.take(order[winners])
