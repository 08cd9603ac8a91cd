"""Change detection: events since a scene was made that several later photos agree on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.localization.changed_space import ChangedPiece, changed_pieces
from fastsplat.service.localization.later_views import LaterView
from fastsplat.service.localization.lost_things import STEPS, Lost, lost_pieces, lost_things, pixels_of, whole
from fastsplat.service.localization.photometric_refinement import Comparison
from fastsplat_contract.photos.localization import ChangeKind, DifferenceKind

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

COMPARED_SIDE = 480  # pixels on the longer side; small things are a few pixels wide

_ALIKE = 0.65
"""Color similarity, 0..1, from which on gone and new pieces are one moved thing."""
_SIZE_RATIO = 2.5
_NEARER = 0.15
"""Similarity deducted per length of the place between both: things seldom move far."""
_LAB = ((0.0, 100.0), (-60.0, 60.0), (-60.0, 60.0))
_CELLS = (4, 10, 10)


@dataclass(frozen=True)
class Region:
    """Bounding box of an event in a photo."""

    view: int  # row of the photo
    kind: DifferenceKind  # "missing": only in the scene; "new": only in the photo
    box: tuple[int, int, int, int]  # left, top, right, bottom, pixels of the comparison


@dataclass(frozen=True)
class Change:
    """An event, with its places before and after."""

    kind: ChangeKind
    thing_id: int  # its id in the scene; 0 if it is none of the scene's things
    views: tuple[int, ...]  # rows of the photos that agree
    probability: float
    before: F64 | None  # [2, 3], lowest and highest corners, world frame, scene units
    after: F64 | None
    regions: tuple[Region, ...]


@dataclass(frozen=True)
class Changes:
    """Result of the change detection."""

    events: tuple[Change, ...]  # the surest first
    seen: tuple[int, ...]  # ids of the things that at least two photos should show


def find_changes(
    views: Sequence[LaterView], boxes: Mapping[int, F64], place: F64, surfaces: frozenset[int] = frozenset()
) -> Changes:
    """Finds events that at least two photos agree on.

    - gone: a thing half of whose pixels have colors that the median photo lacks nearby, or a surface piece like that.
    - new: space on or before the scene's surfaces whose projections have colors that the scene has not.
    - moved: a gone and a new piece that look alike.
    - changed: a gone thing at whose border the photos have a strong color step, too.

    Color steps at the border tell which picture shows an object before the other's background.

    Args:
        boxes: [2, 3] of each thing, lowest and highest corners, scene units.
        place: [2, 3], bounds of the searched space.
        surfaces: ids of floors, walls and tables, which are never gone.
    """
    lost, seen = lost_things(views, boxes, surfaces)
    lost += lost_pieces(views, lost, place)
    comparisons = [view.comparison for view in views]
    maps = [
        (view.only_in_photo, view.unknown(aside, view.comparison.covered))
        for view, aside in zip(views, pixels_of(views, lost), strict=True)
    ]
    pieces = changed_pieces(comparisons, maps, place)
    events = _events(comparisons, whole(lost), pieces, float((place[1] - place[0]).max()))
    return Changes(tuple(sorted(events, key=lambda event: -event.probability)), tuple(seen))


def _events(
    comparisons: Sequence[Comparison], lost: Sequence[Lost], pieces: Sequence[ChangedPiece], length: float
) -> list[Change]:
    looks_lost = [_colors([each.shown for each in comparisons], one) for one in lost]
    looks_new = [_colors([each.photo for each in comparisons], piece) for piece in pieces]
    pairs = []
    for row, one in enumerate(lost):
        for number, piece in enumerate(pieces):
            likeness = _likeness(looks_lost[row], looks_new[number])
            if likeness >= _ALIKE and _size_ratio(one.box, piece.box) <= _SIZE_RATIO:
                pairs.append((likeness - _NEARER * _distance(one.box, piece.box) / length, row, number))
    moved: dict[int, int] = {}
    for _, row, number in sorted(pairs, reverse=True):
        if row not in moved and number not in moved.values():
            moved[row] = number
    left = [piece for number, piece in enumerate(pieces) if number not in moved.values()]
    events: list[Change] = []
    for row, one in enumerate(lost):
        sure, regions = _sure(one), _regions(one, "missing")
        if row in moved:
            piece = pieces[moved[row]]
            sure, regions = min(sure, _sure(piece)), (*regions, *_regions(piece, "new"))
            views = tuple(sorted({*one.views, *piece.views}))
            events.append(Change("moved", one.thing_id, views, sure, one.box, piece.box, regions))
        elif one.step > STEPS:
            events.append(Change("changed", one.thing_id, one.views, sure, one.box, one.box, regions))
        else:
            events.append(Change("gone", one.thing_id, one.views, sure, one.box, None, regions))
    for piece in left:
        events.append(Change("new", 0, piece.views, _sure(piece), None, piece.box, _regions(piece, "new")))
    return events


def _regions(of: Lost | ChangedPiece, kind: DifferenceKind) -> tuple[Region, ...]:
    return tuple(Region(row, kind, _around(own)) for row, own in zip(of.views, of.pixels, strict=True))


def _around(pixels: Bools) -> tuple[int, int, int, int]:
    rows, columns = np.nonzero(pixels)
    return int(columns.min()), int(rows.min()), int(columns.max()) + 1, int(rows.max()) + 1


def _sure(of: Lost | ChangedPiece) -> float:
    """Combines the share of changed pixels and the number of agreeing photos, 0..1."""
    return float(of.share * (1 - 0.5 ** len(of.views)))


def _size_ratio(one: F64, other: F64) -> float:
    lengths = [max(float(np.linalg.norm(box[1] - box[0])), 1e-9) for box in (one, other)]
    return max(lengths) / min(lengths)


def _distance(one: F64, other: F64) -> float:
    return float(np.linalg.norm(one.mean(axis=0) - other.mean(axis=0)))


def _colors(pictures: Sequence[F32], of: Lost | ChangedPiece) -> F64:
    """CIELAB histogram of a region, float64 [K], sum 1; few brightness bins because light differs."""
    colors = np.concatenate([pictures[row][own] for row, own in zip(of.views, of.pixels, strict=True)])
    if not len(colors):
        return np.zeros(int(np.prod(_CELLS)))
    lab = cv2.cvtColor(colors[None].astype(np.float32), cv2.COLOR_RGB2LAB)[0]
    counts, _ = np.histogramdd(lab.clip(*np.array(_LAB).T), bins=_CELLS, range=_LAB)
    return np.asarray(counts.ravel() / counts.sum(), np.float64)


def _likeness(one: F64, other: F64) -> float:
    """Bhattacharyya coefficient (1943) of two histograms, 0..1."""
    return float(np.sqrt(one * other).sum())
