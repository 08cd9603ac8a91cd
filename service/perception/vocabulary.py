"""Names to dictionary entries: synonyms, counts, order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import Dictionary, DictionaryEntry, label_key
from fastsplat.service.perception.boxes import box_iou
from fastsplat.service.perception.types import Detections, Labelling, Regions, TextEncoder
from fastsplat_contract.errors import InvalidInputError


def synonyms(detections: Sequence[Detections], encoder: TextEncoder, *, cosine: float, iou: float) -> dict[str, str]:
    """Which kinds are another's synonym: alias → the kind that keeps the entry.

    Two kinds are synonyms when their names' embeddings are closer than `cosine` and they lie in the same place: over
    the views that show both, the mean of each box's best overlap with a box of the other kind exceeds `iou`. (A
    promptable segmenter makes the same mask of the same box, so boxes tell as much as masks, before masks exist.) The
    kind seen in more views keeps the entry, of equals the one seen first.
    """
    views: dict[str, int] = {}
    for view in detections:
        for kind in dict.fromkeys(view.labels):
            views[kind] = views.get(kind, 0) + 1
    if len(views) < 2:
        return {}
    kinds = sorted(views, key=lambda kind: -views[kind])
    embeddings = dict(zip(kinds, encoder.encode(kinds), strict=True))
    keeper: dict[str, str] = {}
    for first, second in combinations(kinds, 2):
        close = float(embeddings[first] @ embeddings[second]) > cosine
        if close and second not in keeper and _same_place(detections, first, second) > iou:
            keeper[second] = keeper.get(first, first)
    return keeper


def _same_place(detections: Sequence[Detections], first: str, second: str) -> float:
    overlaps = []
    for view in detections:
        rows = [[i for i, label in enumerate(view.labels) if label == kind] for kind in (first, second)]
        if rows[0] and rows[1]:
            matrix = box_iou(view.boxes[rows[0]], view.boxes[rows[1]])
            overlaps.append((matrix.max(1).mean() + matrix.max(0).mean()) / 2)
    return float(np.mean(overlaps)) if overlaps else 0.0


def renamed(detections: Sequence[Detections], keeper: Mapping[str, str]) -> list[Detections]:
    """The detections with every alias under the name of its keeper."""
    return [
        Detections(view.boxes, view.scores, tuple(keeper.get(kind, kind) for kind in view.labels))
        for view in detections
    ]


def finished(
    kinds: Sequence[str],
    maps: Sequence[NDArray[np.uint16]],
    aliases: Mapping[str, str],
    *,
    min_pixels: int,
    regions: Sequence[Regions] = (),
    expected: bool = False,
) -> Labelling:
    """Dictionary and label maps in their final numbering: most pixels first, ties by name.

    Kinds that hold fewer than `min_pixels` in every view are dropped, their pixels become undetected; but an `expected`
    kind that a region was also called stays.

    Args:
        kinds: names in the maps' present numbering, from 1.
        maps: uint16 [H, W] each.
        aliases: see `synonyms`.
        min_pixels: see the settings.
        regions: of each view, with votes in the present numbering.
        expected: see `Labelling`.
    """
    counts = _counts(maps, len(kinds))
    heard = {label for view in regions for votes in view.votes for label, _ in votes} if expected else set()
    entries = [
        (
            DictionaryEntry(
                kind,
                tuple(sorted(alias for alias, keeper in aliases.items() if keeper == kind)),
                int(counts[:, row + 1].sum()),
                int((counts[:, row + 1] > 0).sum()),
            ),
            row + 1,
        )
        for row, kind in enumerate(kinds)
        if len(maps) and (counts[:, row + 1].max() >= min_pixels or row + 1 in heard)
    ]
    entries.sort(key=lambda pair: (-pair[0].pixels, label_key(pair[0].label)))
    lookup = np.zeros(len(kinds) + 1, np.uint16)
    for new, (_, old) in enumerate(entries, start=1):
        lookup[old] = new
    return Labelling(
        Dictionary(tuple(entry for entry, _ in entries)),
        tuple(lookup[m] for m in maps),
        regions=tuple(_renumbered(view, lookup) for view in regions),
        expected=expected,
    )


def _renumbered(view: Regions, lookup: NDArray[np.uint16]) -> Regions:
    votes = (tuple((int(lookup[label]), score) for label, score in region if lookup[label]) for region in view.votes)
    return Regions(view.ids, tuple(votes))


def counted(dictionary: Dictionary, maps: Sequence[NDArray[np.uint16]]) -> Labelling:
    """A given dictionary, in its own order, with the counts of given maps, which are taken to be exact.

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
        DictionaryEntry(entry.label, entry.aliases, int(counts[:, i].sum()), int((counts[:, i] > 0).sum()))
        for i, entry in enumerate(dictionary.entries, start=1)
    )
    return Labelling(Dictionary(entries), tuple(maps), exact=True)


def _counts(maps: Sequence[NDArray[np.uint16]], labels: int) -> NDArray[np.int64]:
    """int64 [views, labels + 1]: pixels by view and id."""
    rows = [np.bincount(label_map.ravel(), minlength=labels + 1)[: labels + 1] for label_map in maps]
    return np.stack(rows).astype(np.int64) if rows else np.zeros((0, labels + 1), np.int64)
