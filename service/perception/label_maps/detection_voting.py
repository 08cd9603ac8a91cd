"""Votes over all views: classes in the scene, and one class per object."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from math import ceil

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.perception.box_ops import box_iou, nms
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Detections

SAME_LABEL_IOU = 0.6
"""Boxes of one class that overlap more are one detection."""


def merge_spellings(detections: Sequence[Detections], names: Sequence[str] = ()) -> list[Detections]:
    """Unifies labels with the same `label_key`: to the one in `names`, else the first."""
    name_by_key: dict[str, str] = {}
    for label in (*names, *(label for view in detections for label in view.labels)):
        name_by_key.setdefault(label_key(label), label)
    return [
        Detections(view.boxes, view.scores, tuple(name_by_key[label_key(label)] for label in view.labels))
        for view in detections
    ]


def resolve_detections(
    detections: Sequence[Detections], settings: PerceptionSettings, *, named: bool
) -> tuple[list[Detections], dict[str, float]]:
    """Selects the detections supported by the views, one per object; also each class's support.

    A class is in the scene if it scores `score_threshold` in enough views (`min_view_share`, `min_views`; one view if
    the user `named` it). Of overlapping boxes of one class the best stays, of two classes (`rival_iou`) the one with
    the larger score × support, where support is the class's best score averaged over views. This is repeated until the
    classes are stable.
    """
    views, floor = len(detections), settings.score_floor
    enough = 1 if named else min(views, max(settings.min_views, ceil(settings.min_view_share * views)))
    classes = _believed(detections, settings.score_threshold, enough)
    while True:  # ends: the set of classes only shrinks
        candidates = [
            view.take([row for row, label in enumerate(view.labels) if label in classes and view.scores[row] >= floor])
            for view in detections
        ]
        support = _support(candidates)
        resolved = [_without_duplicates(view, support, settings) for view in candidates]
        remaining = _believed(resolved, settings.score_threshold, enough) & classes
        if remaining == classes:
            return resolved, support
        classes = remaining


def region_votes(
    resolved: Detections, candidates: Detections, ids: Mapping[str, int], rival_iou: float
) -> list[dict[int, float]]:
    """Collects, per resolved detection, the best score by label id of boxes in its place.

    Args:
        resolved: the resolved ones of `candidates` in a view.
        candidates: all detections of the view that score enough to count.
        ids: label id of each class; others have no vote.
        rival_iou: boxes that overlap more are in the same place.
    """
    overlap = box_iou(resolved.boxes, candidates.boxes)
    votes: list[dict[int, float]] = []
    for row, (label, score) in enumerate(zip(resolved.labels, resolved.scores, strict=True)):
        scores = {ids[label]: float(score)}
        for candidate in np.flatnonzero(overlap[row] > rival_iou):
            label_id = ids.get(candidates.labels[candidate])
            if label_id is not None:
                scores[label_id] = max(scores.get(label_id, 0.0), float(candidates.scores[candidate]))
        votes.append(scores)
    return votes


def detection_weights(view: Detections, support: Mapping[str, float]) -> NDArray[np.float32]:
    """float32 [K]: score × support, by which rivals are compared."""
    return view.scores * np.array([support[label] for label in view.labels], np.float32)


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


def _without_duplicates(view: Detections, support: Mapping[str, float], settings: PerceptionSettings) -> Detections:
    rows: list[int] = []
    for label in dict.fromkeys(view.labels):
        group = np.array([row for row, name in enumerate(view.labels) if name == label])
        rows += group[nms(view.boxes[group], view.scores[group], SAME_LABEL_IOU)].tolist()
    view = view.take(rows)
    weights, overlap = detection_weights(view, support), box_iou(view.boxes, view.boxes)
    winners: list[int] = []
    for row in np.argsort(-weights, kind="stable"):
        rivals = [winner for winner in winners if view.labels[winner] != view.labels[row]]
        if all(overlap[row, rival] <= settings.rival_iou for rival in rivals):
            winners.append(int(row))
    return view.take(winners)
