"""A closer look at each thing: pictures of the thing alone, in which a detector's boxes are the thing or are not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.box_ops import box_iou
from fastsplat.service.perception.types import Detections
from fastsplat_contract.camera import Camera, PosedCamera

F32 = NDArray[np.float32]

_EDGE_PERCENT = 1.0
"""Of a thing's pixels that may lie outside of its box on each side: a few strays say nothing of its size."""
_LEAST_PX = 60
"""Pixels of a thing that are worth a closer look."""
_CONTEXT = 2.0
"""Side of the picture over the longer side of the thing's box."""
_WHOLE = 0.9
"""A picture of this share of a view's longer side is no closer look."""


@dataclass(frozen=True)
class ThingInView:
    """Where a thing is in a view.

    Attributes:
        box: float32 [4], x1, y1, x2, y2 in pixels of the view.
        pixels: how many show it.
    """

    thing_id: int
    box: F32
    pixels: int


def things_in_map(thing_map: NDArray[np.integer]) -> list[ThingInView]:
    """The things that a map [H, W] of ids shows well enough for a closer look, by id; 0 is none."""
    shown = []
    for thing_id in np.unique(thing_map[thing_map > 0]).tolist():
        rows, columns = np.nonzero(thing_map == thing_id)
        if len(rows) >= _LEAST_PX:
            low, high = (_EDGE_PERCENT, 100 - _EDGE_PERCENT)
            (x1, x2), (y1, y2) = np.percentile(columns, [low, high]), np.percentile(rows, [low, high])
            shown.append(ThingInView(thing_id, np.array([x1, y1, x2 + 1, y2 + 1], np.float32), len(rows)))
    return shown


def best_positions(shown: Sequence[Sequence[ThingInView]], limit: int) -> Mapping[int, tuple[int, ...]]:
    """For each thing the positions of at most `limit` views that show the most of its pixels, the best first.

    Args:
        shown: of each view the things that it shows well.
        limit: at least 1.
    """
    views: dict[int, list[tuple[int, int]]] = {}
    for position, things in enumerate(shown):
        for thing in things:
            views.setdefault(thing.thing_id, []).append((-thing.pixels, position))
    return {thing_id: tuple(position for _, position in sorted(pairs)[:limit]) for thing_id, pairs in views.items()}


def closer_look(posed: PosedCamera, box: F32, largest_scale: float, side: int) -> tuple[PosedCamera, F32] | None:
    """The camera that sees a box and as much around it, and the box in its picture; None where that is about the whole
    view.

    Args:
        posed: the view that the box is of.
        box: float32 [4], x1, y1, x2, y2 in its pixels.
        largest_scale: pixels of the new picture for one of the view, at most; never fewer than one.
        side: pixels of the new picture's longer side, at most, as long as that is one for one of the view.
    """
    camera = posed.camera
    reach = _CONTEXT / 2 * max(float(box[2] - box[0]), float(box[3] - box[1]))
    x, y = (float(box[0]) + float(box[2])) / 2, (float(box[1]) + float(box[3])) / 2
    left, top = max(0, int(x - reach)), max(0, int(y - reach))
    right, bottom = min(camera.width, int(np.ceil(x + reach))), min(camera.height, int(np.ceil(y + reach)))
    width, height = max(1, right - left), max(1, bottom - top)
    if max(width, height) > _WHOLE * max(camera.width, camera.height):
        return None
    scale = max(1.0, min(largest_scale, side / max(width, height)))
    part = Camera(width, height, camera.fx, camera.fy, camera.cx - left, camera.cy - top)
    closer = part.scaled_to(max(1, round(width * scale)), max(1, round(height * scale)))
    ratio = np.array([closer.width / width, closer.height / height] * 2, np.float32)
    return replace(posed, camera=closer), ((box - np.array([left, top, left, top], np.float32)) * ratio)


def votes_for(detections: Detections, box: F32, min_overlap: float) -> dict[str, float]:
    """The best score of each label among the boxes that overlap `box` by at least `min_overlap`."""
    overlap = box_iou(box[None], detections.boxes)[0]
    votes: dict[str, float] = {}
    for row in np.flatnonzero(overlap >= min_overlap):
        label = detections.labels[row]
        votes[label] = max(votes.get(label, 0.0), float(detections.scores[row]))
    return votes


def mean_votes(votes: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """The mean score of each label over several pictures of one thing; a picture without the label counts as 0."""
    labels = {label for own in votes for label in own}
    return {label: sum(own.get(label, 0.0) for own in votes) / len(votes) for label in sorted(labels)}
