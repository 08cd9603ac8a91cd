"""Dictionary entries from class names: synonyms, counts, confidence, order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import Dictionary, DictionaryEntry, label_key
from fastsplat.service.perception.box_ops import box_iou
from fastsplat.service.perception.results import Detections, Labelling, Regions, TextEncoder
from fastsplat_contract.errors import InvalidInputError


def synonyms(detections: Sequence[Detections], encoder: TextEncoder, *, cosine: float, iou: float) -> dict[str, str]:
    """Maps aliases to the class that keeps the entry, the one detected in more views.

    Synonyms have name embeddings closer than `cosine` and lie in the same place: the mean best overlap of their boxes
    over the views that show both exceeds `iou`.
    """
    views: dict[str, int] = {}
    for view in detections:
        for label in dict.fromkeys(view.labels):
            views[label] = views.get(label, 0) + 1
    if len(views) < 2:
        return {}
    classes = sorted(views, key=lambda label: -views[label])
    embeddings = dict(zip(classes, encoder.encode(classes), strict=True))
    entry_of: dict[str, str] = {}
    for first, second in combinations(classes, 2):
        close = float(embeddings[first] @ embeddings[second]) > cosine
        if close and second not in entry_of and _same_place(detections, first, second) > iou:
            entry_of[second] = entry_of.get(first, first)
    return entry_of


def _same_place(detections: Sequence[Detections], first: str, second: str) -> float:
    overlaps = []
    for view in detections:
        rows = [[i for i, label in enumerate(view.labels) if label == name] for name in (first, second)]
        if rows[0] and rows[1]:
            matrix = box_iou(view.boxes[rows[0]], view.boxes[rows[1]])
            overlaps.append((matrix.max(1).mean() + matrix.max(0).mean()) / 2)
    return float(np.mean(overlaps)) if overlaps else 0.0


def merge_synonyms(detections: Sequence[Detections], entry_of: Mapping[str, str]) -> list[Detections]:
    """Renames aliases to their entries, see `synonyms`."""
    return [
        Detections(view.boxes, view.scores, tuple(entry_of.get(label, label) for label in view.labels))
        for view in detections
    ]


def build_labelling(
    classes: Sequence[str],
    maps: Sequence[NDArray[np.uint16]],
    aliases: Mapping[str, str],
    *,
    min_pixels: int,
    regions: Sequence[Regions] = (),
    expected: bool = False,
) -> Labelling:
    """Numbers dictionary and label maps: most pixels first, ties by name.

    Classes with fewer than `min_pixels` in every view become undetected, except `expected` (requested) ones with a
    vote.

    Args:
        classes: names in the maps' present numbering, from 1.
        maps: uint16 [H, W] each.
        regions: of each view, with votes in the present numbering; none: the names are taken as sure.
    """
    counts = _counts(maps, len(classes))
    voted = {label for view in regions for votes in view.votes for label, _ in votes} if expected else set()
    confidence = name_confidence(maps, regions, len(classes)) if regions else np.ones(len(classes))
    entries = [
        (
            DictionaryEntry(
                label,
                tuple(sorted(alias for alias, entry in aliases.items() if entry == label)),
                int(counts[:, row + 1].sum()),
                int((counts[:, row + 1] > 0).sum()),
                float(confidence[row]),
            ),
            row + 1,
        )
        for row, label in enumerate(classes)
        if len(maps) and (counts[:, row + 1].max() >= min_pixels or row + 1 in voted)
    ]
    entries.sort(key=lambda pair: (-pair[0].pixels, label_key(pair[0].label)))
    lookup = np.zeros(len(classes) + 1, np.uint16)
    for new, (_, old) in enumerate(entries, start=1):
        lookup[old] = new
    return Labelling(
        Dictionary(tuple(entry for entry, _ in entries)),
        tuple(lookup[m] for m in maps),
        regions=tuple(_renumbered(view, lookup) for view in regions),
    )


def name_confidence(
    maps: Sequence[NDArray[np.uint16]], regions: Sequence[Regions], classes: int
) -> NDArray[np.float64]:
    """Confidence of class labels from detection scores, float64 [N], 0..1.

    It is share × (1 − Π_v (1 − s_v)). s_v is the best score for the class in view v, the product the noisy-or of the
    views (Pearl 1988), which errs upwards as views err alike. share is that of the class's votes among all in the
    regions that carry the label (in all regions with a vote for it, if none does).

    Args:
        maps: uint16 [H, W] of each view, classes from 1.
        regions: of each view, with votes in the same numbering.
        classes: N.
    """
    winning_votes, any_region = _Votes(classes, len(regions)), _Votes(classes, len(regions))
    for view, (label_map, proposals) in enumerate(zip(maps, regions, strict=True)):
        region_labels = np.zeros(len(proposals.votes) + 1, np.int64)
        region_labels[proposals.ids.ravel()] = label_map.ravel()  # a region has one label
        for region_label, votes in zip(region_labels[1:].tolist(), proposals.votes, strict=True):
            total = sum(score for _, score in votes)
            for label, score in votes:
                any_region.add(view, label, score, total)
                if label == region_label:
                    winning_votes.add(view, label, score, total)
    return np.where(winning_votes.total > 0, winning_votes.confidence(), any_region.confidence())


class _Votes:
    """Votes for N classes in V views."""

    def __init__(self, classes: int, views: int) -> None:
        self.best = np.zeros((views, classes))
        self.votes = np.zeros(classes)
        self.total = np.zeros(classes)

    def add(self, view: int, label: int, score: float, total: float) -> None:
        """Adds a label's score in a region, of `total` for all labels there."""
        self.best[view, label - 1] = max(self.best[view, label - 1], score)
        self.votes[label - 1] += score
        self.total[label - 1] += total

    def confidence(self) -> NDArray[np.float64]:
        """float64 [N], see `name_confidence`; 0 without votes."""
        share = self.votes / np.maximum(self.total, np.finfo(np.float64).tiny)
        return np.asarray(np.clip(share * (1.0 - np.prod(1.0 - self.best, axis=0)), 0.0, 1.0))


def _renumbered(view: Regions, lookup: NDArray[np.uint16]) -> Regions:
    votes = (tuple((int(lookup[label]), score) for label, score in region if lookup[label]) for region in view.votes)
    return Regions(view.ids, tuple(votes))


def labelling_from_maps(dictionary: Dictionary, maps: Sequence[NDArray[np.uint16]]) -> Labelling:
    """Builds an exact labelling from a capture's own maps, with counts.

    Raises:
        InvalidInputError: a map holds an id that the dictionary does not have.
    """
    highest = max((int(label_map.max(initial=0)) for label_map in maps), default=0)
    if highest > len(dictionary):
        raise InvalidInputError(
            f"a label map holds the id {highest}, and the dictionary has {len(dictionary)} entries",
            field="labels",
            hint="List every id of the maps in labels.json.",
        )
    counts = _counts(maps, len(dictionary))
    entries = tuple(
        replace(entry, pixels=int(counts[:, i].sum()), views=int((counts[:, i] > 0).sum()))
        for i, entry in enumerate(dictionary.entries, start=1)
    )
    return Labelling(Dictionary(entries), tuple(maps), exact=True)


def _counts(maps: Sequence[NDArray[np.uint16]], labels: int) -> NDArray[np.int64]:
    """int64 [views, labels + 1]: pixels by view and id."""
    rows = [np.bincount(label_map.ravel(), minlength=labels + 1)[: labels + 1] for label_map in maps]
    return np.stack(rows).astype(np.int64) if rows else np.zeros((0, labels + 1), np.int64)
