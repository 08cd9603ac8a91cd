"""Mask proposals without names or a vocabulary, from a segmenter.

Prompts are a detector's boxes, which tell how much is one object, then points where no mask, or only a large one, is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.box_ops import nms
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import (
    Detections,
    MaskLogits,
    Segmenter,
    ViewMasks,
    box_prompts,
    point_prompts,
)
from fastsplat.service.perception.segmenters.mask_postprocessing import best_answers, upsampled

_LEAST_RADIUS = 2.0
"""Least grid steps to the edge of a piece: smaller ones are gaps between masks.

A pencil on a table reaches farther: the table's mask has a hole of its shape.
"""
_APART, _LEAST_APART = 1.5, 24  # points keep this share of their distance to the edge from each other; least steps
_ANSWERED = 3  # grid steps around a prompt that are not prompted again, whatever the answer
_SMALL = 0.05  # masks with a smaller share of the image are objects or parts, not prompted inside again


class CutImage:
    """An image cut into pieces by masks, with pieces that need no prompt.

    In `pieces`, int64 [h, w], pixels in the same masks have the same number, those in none 0.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.pieces = np.zeros(shape, np.int64)
        self._small = np.zeros(shape, np.bool_)
        self._random = np.random.default_rng(0)

    def add(self, masks: NDArray[np.bool_]) -> None:
        """Cuts the pieces by masks, bool [P, h, w]."""
        small = masks.mean(axis=(1, 2)) < _SMALL
        self._small |= masks[small].any(axis=0)
        for mask in masks:  # sums of random numbers tell sets of masks apart
            self.pieces[mask] += self._random.integers(1, 1 << 56)

    def answered(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """bool [h, w]: in small masks and prompted pieces, and near `points` [K, 2]."""
        columns, rows = points.astype(int).T
        prompted = self.pieces[rows, columns]
        result = self._small | np.isin(self.pieces, prompted[prompted != 0])
        for x, y in zip(columns, rows, strict=True):
            result[max(0, y - _ANSWERED) : y + _ANSWERED + 1, max(0, x - _ANSWERED) : x + _ANSWERED + 1] = True
        return np.asarray(result)


def open_points(pieces: NDArray[np.integer[Any]], answered: NDArray[np.bool_], count: int) -> NDArray[np.float64]:
    """Chooses at most `count` points [K, 2], x and y, farthest from edges first.

    Edges are those of pieces [h, w], of `answered` pixels and of the image. Points of a connected piece are kept apart.
    """
    inner = ~answered
    inner[1:] &= pieces[1:] == pieces[:-1]
    inner[:, 1:] &= pieces[:, 1:] == pieces[:, :-1]
    padded = np.pad(inner.astype(np.uint8), 1)  # the image's edge is an edge
    depth = cv2.distanceTransform(padded, cv2.DIST_L2, 3)[1:-1, 1:-1]
    connected = cv2.connectedComponents(inner.astype(np.uint8), connectivity=4)[1]
    points: list[tuple[float, float]] = []
    while len(points) < count:
        row, column = np.unravel_index(int(depth.argmax()), depth.shape)
        radius = float(depth[row, column])
        if radius < _LEAST_RADIUS:
            break
        points.append((column + 0.5, row + 0.5))
        around = np.zeros(depth.shape, np.uint8)
        cv2.circle(around, (int(column), int(row)), math.ceil(max(_LEAST_APART, _APART * radius)), 1, cv2.FILLED)
        depth[(around > 0) & (connected == connected[row, column])] = 0
    return np.array(points, np.float64).reshape(-1, 2)


_PROPOSAL_OVERLAP = 0.75  # masks without names of a view that overlap more are one
_PROPOSAL_SIDE = 640  # pixels of stored masks on the image's longer side

_ROUNDS = (0.25, 0.6, 1.0)  # share of points prompted by the end of each round; later rounds skip what is explained
_BOX_QUALITY, _BOX_STABILITY = 0.7, 0.8  # like the settings' bounds, for answers to boxes, which are not ambiguous


@dataclass(frozen=True)
class MaskProposals:
    """P masks of an image that may overlap: parts, objects and groups of objects."""

    logits: NDArray[np.float16]  # [P, h, w], positive inside, on the segmenter's grid, which covers just the image
    quality: NDArray[np.float32]  # [P], predicted intersection over union times stability, 0..1
    scale: tuple[float, float]  # grid steps per pixel of the image, along x and y
    size: tuple[int, int]  # height and width of the image

    def __post_init__(self) -> None:
        assert self.logits.ndim == 3 and self.logits.dtype == np.float16
        assert self.quality.shape == (len(self.logits),) and self.quality.dtype == np.float32

    def __len__(self) -> int:
        return len(self.quality)

    @property
    def inside(self) -> NDArray[np.bool_]:
        """bool [P, h, w], True for logits above 0."""
        return np.asarray(self.logits.view(np.int16) > 0)  # numpy compares 16-bit floats far more slowly

    def take(self, rows: Sequence[int] | NDArray[np.integer]) -> MaskProposals:
        """Selects rows, in this order."""
        index = np.asarray(rows, np.intp)
        return MaskProposals(self.logits[index], self.quality[index], self.scale, self.size)

    def masks(self, width: int, height: int) -> NDArray[np.bool_]:
        """bool [P, height, width]: the masks resized, with interpolated edges."""
        return upsampled(self.logits, self.scale, self.size, width, height)


def propose_masks(
    segmenter: Segmenter, embedding: Any, boxes: MaskLogits, size: tuple[int, int], settings: PerceptionSettings
) -> ViewMasks:
    """Proposes masks from answers to boxes, then, in rounds, from open points.

    Of a mask found both ways, the box's is kept. `boxes` are from `answer_boxes`, `size` is height and width.
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


def boxes_to_prompt(objects: Detections, candidates: Detections, settings: PerceptionSettings) -> NDArray[np.float32]:
    """Boxes of `objects`, then those of `candidates` that overlap no earlier one above `rival_iou`."""
    boxes = np.concatenate([objects.boxes, candidates.boxes])
    first = np.full(len(objects), 2.0, np.float32)
    rows = nms(boxes, np.concatenate([first, candidates.scores]), settings.rival_iou)
    added = np.array([row for row in rows if row >= len(objects)], np.intp)
    return np.concatenate([objects.boxes, boxes[added]])


def answer_boxes(segmenter: Segmenter, embedding: Any, boxes: NDArray[np.float32]) -> MaskLogits:
    """Answers boxes [K, 4] in pixels by the best masks, logits [K, 1, h, w]."""
    return best_answers(segmenter.mask_logits(embedding, box_prompts(boxes)), boxes)


def sure_proposals(answer: MaskLogits, size: tuple[int, int], settings: PerceptionSettings) -> MaskProposals:
    """Keeps answers with high predicted quality and stability that are no specks.

    Stability is Segment-Anything's: the IoU of the masks cut at logits +1 and -1. `size` is height and width.
    """
    sure = _sure(answer, settings)
    logits = answer.logits[sure].reshape(-1, *answer.logits.shape[2:])
    quality = answer.quality[sure] * _stability(logits)
    return MaskProposals(np.clip(logits, -100, 100).astype(np.float16), quality.astype(np.float32), answer.scale, size)


def _sure(answer: MaskLogits, settings: PerceptionSettings) -> NDArray[np.bool_]:
    """bool [K, M]; areas and stability are only computed for masks of sufficient quality."""
    sure = answer.quality > settings.proposal_quality
    logits = answer.logits[sure]
    area = (logits > 0).sum(axis=(1, 2)) / (answer.scale[0] * answer.scale[1])
    sure[sure] = (_stability(logits) > settings.proposal_stability) & (area >= settings.min_pixels)
    return np.asarray(sure)


def _stability(logits: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    return np.asarray((logits > 1).sum(axis=(1, 2)) / np.maximum((logits > -1).sum(axis=(1, 2)), 1))


def joined_proposals(parts: Sequence[MaskProposals]) -> MaskProposals:
    """Joins at least one round of proposals on one image."""
    logits = np.concatenate([part.logits for part in parts])
    return MaskProposals(logits, np.concatenate([part.quality for part in parts]), parts[0].scale, parts[0].size)


def distinct_proposals(proposals: MaskProposals, max_overlap: float, *, first: int = 0) -> MaskProposals:
    """Non-maximum suppression by quality, after the first `first`; IoU above `max_overlap` is the same."""
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
