"""Masks of whatever is in an image, without a name or a vocabulary: a segmenter's sure answers to boxes of a detector,
which say how much is one object, then to points where no mask, or only a large one, is (`prompt_points`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.box_ops import nms
from fastsplat.service.perception.mask_postprocessing import upsampled
from fastsplat.service.perception.prompt_points import CutImage, open_points
from fastsplat.service.perception.segmenters.mask_selection import best_answers
from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.perception.types import Detections, MaskLogits, Segmenter, ViewMasks, box_prompts, point_prompts

_PROPOSAL_OVERLAP = 0.75
"""Masks without a name of one view that overlap more are one."""
_PROPOSAL_SIDE = 640
"""Masks without names are stored at this many pixels on the image's longer side."""

_ROUNDS = (0.25, 0.6, 1.0)
"""Share of the points that are prompted by the end of each round: what one round explains, the next leaves alone."""
_BOX_QUALITY, _BOX_STABILITY = 0.7, 0.8
"""As the settings' bounds, for answers to boxes, which are not ambiguous."""


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

    @property
    def inside(self) -> NDArray[np.bool_]:
        """bool [P, h, w]: where the logits are above 0."""
        return np.asarray(self.logits.view(np.int16) > 0)  # the same; numpy compares 16-bit floats far more slowly

    def take(self, rows: Sequence[int] | NDArray[np.integer]) -> MaskProposals:
        """Those of these rows, in this order."""
        index = np.asarray(rows, np.intp)
        return MaskProposals(self.logits[index], self.quality[index], self.scale, self.size)

    def masks(self, width: int, height: int) -> NDArray[np.bool_]:
        """bool [P, height, width]: the masks for the image at this size, edges interpolated between grid steps."""
        return upsampled(self.logits, self.scale, self.size, width, height)


def propose_masks(
    segmenter: Segmenter, embedding: Any, boxes: MaskLogits, size: tuple[int, int], settings: PerceptionSettings
) -> ViewMasks:
    """The masks of one image: the answers to boxes, then, in rounds, to points where no mask is, or only a large one. A
    mask that both agree on is the box's.

    Args:
        boxes: the best answer to each box, see `answer_boxes`.
        size: height and width of the image.
    """
    of_boxes = settings.model_copy(update={"proposal_quality": _BOX_QUALITY, "proposal_stability": _BOX_STABILITY})
    parts = [distinct_proposals(sure_proposals(boxes, size, of_boxes), _PROPOSAL_OVERLAP)]
    prompts = len(boxes.quality)
    scale = np.array(boxes.scale)
    of_boxes_alone = boxes.logits[_sure(boxes, of_boxes)] > 0
    cover, points = CutImage(of_boxes_alone.shape[1:]), np.zeros((0, 2))
    cover.add(of_boxes_alone)
    for share in _ROUNDS:
        count = round(settings.proposal_points * share) - len(points)
        fresh = open_points(cover.pieces, cover.answered(points), count)
        if not len(fresh):
            break
        answer = segmenter.mask_logits(embedding, point_prompts(fresh / scale))
        parts.append(sure_proposals(answer, size, settings))
        prompts += len(fresh)
        points = np.concatenate([points, fresh])
        cover.add(parts[-1].inside)
    proposals = distinct_proposals(joined_proposals(parts), _PROPOSAL_OVERLAP, first=len(parts[0]))
    factor = min(1.0, _PROPOSAL_SIDE / max(size))
    height, width = (max(1, round(side * factor)) for side in size)
    bits = np.packbits(proposals.masks(width, height).reshape(len(proposals), height * width), axis=1)
    return ViewMasks(bits, proposals.quality, width, height, prompts)


def boxes_to_prompt(objects: Detections, others: Detections, settings: PerceptionSettings) -> NDArray[np.float32]:
    """float32 [K, 4]: the boxes of `objects`, in their order, then those of `others` that overlap none before by more
    than `rival_iou`, whatever they are called."""
    boxes = np.concatenate([objects.boxes, others.boxes])
    first = np.full(len(objects), 2.0, np.float32)
    rows = nms(boxes, np.concatenate([first, others.scores]), settings.rival_iou)
    added = np.array([row for row in rows if row >= len(objects)], np.intp)
    return np.concatenate([objects.boxes, boxes[added]])


def answer_boxes(segmenter: Segmenter, embedding: Any, boxes: NDArray[np.float32]) -> MaskLogits:
    """The segmenter's best answer to each of [K, 4] boxes in pixels of the image: logits [K, 1, h, w]."""
    return best_answers(segmenter.mask_logits(embedding, box_prompts(boxes)), boxes)


def sure_proposals(answer: MaskLogits, size: tuple[int, int], settings: PerceptionSettings) -> MaskProposals:
    """The answers that the segmenter predicts to be good, that are stable (Segment-Anything's score: IoU of the masks
    cut at logits +1 and -1) and that are no specks.

    Args:
        answer: to K prompts, M masks each.
        size: height and width of the image.
        settings: `proposal_quality`, `proposal_stability` and `min_pixels`.
    """
    sure = _sure(answer, settings)
    logits = answer.logits[sure].reshape(-1, *answer.logits.shape[2:])
    quality = answer.quality[sure] * _stability(logits)
    return MaskProposals(np.clip(logits, -100, 100).astype(np.float16), quality.astype(np.float32), answer.scale, size)


def _sure(answer: MaskLogits, settings: PerceptionSettings) -> NDArray[np.bool_]:
    """bool [K, M]; only the masks that are predicted to be good are looked at."""
    sure = answer.quality > settings.proposal_quality
    logits = answer.logits[sure]
    area = (logits > 0).sum(axis=(1, 2)) / (answer.scale[0] * answer.scale[1])
    sure[sure] = (_stability(logits) > settings.proposal_stability) & (area >= settings.min_pixels)
    return np.asarray(sure)


def _stability(logits: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    return np.asarray((logits > 1).sum(axis=(1, 2)) / np.maximum((logits > -1).sum(axis=(1, 2)), 1))


def joined_proposals(parts: Sequence[MaskProposals]) -> MaskProposals:
    """All proposals of several rounds of prompts on one image; at least one part."""
    logits = np.concatenate([part.logits for part in parts])
    return MaskProposals(logits, np.concatenate([part.quality for part in parts]), parts[0].scale, parts[0].size)


def distinct_proposals(proposals: MaskProposals, max_overlap: float, *, first: int = 0) -> MaskProposals:
    """The best of every set of proposals that are the same mask: the first `first`, then the others, both by descending
    quality, those whose intersection over union with each one before is at most `max_overlap` (non-maximum
    suppression)."""
    if not len(proposals):
        return proposals
    later = np.arange(len(proposals)) >= first
    order = np.lexsort([-proposals.quality, later])
    flat = proposals.inside[order].reshape(len(order), -1).astype(np.float32)
    common = flat @ flat.T
    areas = flat.sum(axis=1)
    double = common > max_overlap * (areas[:, None] + areas - common)
    free, winners = np.ones(len(order), np.bool_), []
    for row in range(len(order)):
        if free[row]:
            winners.append(row)
            free &= ~double[row]
    return proposals.take(order[winners])
