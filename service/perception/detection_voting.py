"""What the capture as a whole says about single detections: which kinds are in the scene, and which is which."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from math import ceil

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.perception.box_ops import box_iou, suppress
from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.perception.types import Detections


def one_name_each(detections: Sequence[Detections], names: Sequence[str] = ()) -> list[Detections]:
    """Give all spellings with one `label_key` one name: the one in `names`, else the first in view order."""
    chosen: dict[str, str] = {}
    for label in (*names, *(label for view in detections for label in view.labels)):
        chosen.setdefault(label_key(label), label)
    return [
        Detections(view.boxes, view.scores, tuple(chosen[label_key(label)] for label in view.labels))
        for view in detections
    ]


def settle(
    detections: Sequence[Detections], settings: PerceptionSettings, *, named: bool
) -> tuple[list[Detections], dict[str, float]]:
    """Keep what the views together believe, one detection per thing; and each kind's support.

    A kind is believed when it scores `score_threshold` in enough views (`min_view_share`, `min_views`; one view if the
    user `named` it). Detections of a believed kind count from `score_floor`. Of boxes of one kind that overlap by more
    than `same_label_iou`, the best stays. Where boxes of two kinds overlap by more than `rival_iou`, the one with the
    larger score × support stays, support being the mean over the views of the kind's best score: a cushion that looks
    like a cake in one photo stays a cushion. Since a kind may lose all its sightings to a rival, this repeats until
    the believed kinds stand.
    """
    enough = (
        1 if named else min(len(detections), max(settings.min_views, ceil(settings.min_view_share * len(detections))))
    )
    kinds = _believed(detections, settings.score_threshold, enough)
    while True:  # ends: the set of kinds only shrinks
        candidates = [
            view.take(
                [i for i, kind in enumerate(view.labels) if kind in kinds and view.scores[i] >= settings.score_floor]
            )
            for view in detections
        ]
        support = _support(candidates)
        settled = [_without_doubles(view, support, settings) for view in candidates]
        left = _believed(settled, settings.score_threshold, enough) & kinds
        if left == kinds:
            return settled, support
        kinds = left


def votes_for(
    settled: Detections, likely: Detections, ids: Mapping[str, int], rival_iou: float
) -> list[dict[int, float]]:
    """For each settled detection, the label ids that boxes in its place were given, and their best scores.

    Args:
        settled: what stayed of `likely` in one view.
        likely: all detections of the view that score enough to count.
        ids: label id of each kind; others have no vote.
        rival_iou: boxes that overlap more are in one place.
    """
    overlap = box_iou(settled.boxes, likely.boxes)
    votes: list[dict[int, float]] = []
    for row, (kind, score) in enumerate(zip(settled.labels, settled.scores, strict=True)):
        found = {ids[kind]: float(score)}
        for other in np.flatnonzero(overlap[row] > rival_iou):
            label = ids.get(likely.labels[other])
            if label is not None:
                found[label] = max(found.get(label, 0.0), float(likely.scores[other]))
        votes.append(found)
    return votes


def weights(view: Detections, support: Mapping[str, float]) -> NDArray[np.float32]:
    """float32 [K]: score × support, what rivals are compared by."""
    return view.scores * np.array([support[kind] for kind in view.labels], np.float32)


def _believed(detections: Sequence[Detections], threshold: float, enough: int) -> set[str]:
    views: dict[str, int] = defaultdict(int)
    for view in detections:
        for label in {label for label, score in zip(view.labels, view.scores, strict=True) if score >= threshold}:
            views[label] += 1
    return {label for label, count in views.items() if count >= enough}


def _support(detections: Sequence[Detections]) -> dict[str, float]:
    total: dict[str, float] = defaultdict(float)
    for view in detections:
        for label in set(view.labels):
            total[label] += max(float(s) for s, name in zip(view.scores, view.labels, strict=True) if name == label)
    return {label: value / len(detections) for label, value in total.items()}


def _without_doubles(view: Detections, support: Mapping[str, float], settings: PerceptionSettings) -> Detections:
    rows: list[int] = []
    for kind in dict.fromkeys(view.labels):
        group = np.array([i for i, label in enumerate(view.labels) if label == kind])
        rows += group[suppress(view.boxes[group], view.scores[group], settings.same_label_iou)].tolist()
    view = view.take(rows)
    strength, overlap = weights(view, support), box_iou(view.boxes, view.boxes)
    kept: list[int] = []
    for row in np.argsort(-strength, kind="stable"):
        rivals = [other for other in kept if view.labels[other] != view.labels[row]]
        if all(overlap[row, other] <= settings.rival_iou for other in rivals):
            kept.append(int(row))
    return view.take(kept)
