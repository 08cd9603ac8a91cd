"""What has changed in a place since its scene was made: events that several later photos agree on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.localization.changed_space import ChangedPiece, changed_pieces
from fastsplat.service.localization.photometric_refinement import Comparison
from fastsplat_contract.localize_messages import ChangeKind, DifferenceKind

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

COMPARED_SIDE = 480
"""Photos and scene are compared at so many pixels on the longer side: small things are a few pixels wide."""
FEWEST_VIEWS = 2
"""Photos that have to agree on an event."""

_SLACK_PX = 5
"""Width of the window in which either picture may have the color of the other one: poses are a pixel or two off."""
_LEAST = 0.07
"""Of a color channel, 0..1, beyond what the other picture has around there."""
_TIMES_USUAL = 3.0
"""As many times the usual difference, where the scene is reproduced badly everywhere."""
_FEWEST_PIXELS = 30
_LOST_SHARE = 0.5
"""Of a thing's pixels that the photo does not show: the median over the photos that should show it."""
_WINDOW_PX = 9
_SHADED = (0.45, 1.7)
"""Gains between a surface in light and in shade."""
_SAME_CHROMA = 0.035
_BURNT, _BRIGHT = 0.985, 0.8
_ALIKE = 0.65
"""Similarity of colors, 0..1, from which on what is gone here and new there is one thing that moved."""
_SIZE_RATIO = 2.5
_NEARER = 0.15
"""Likeness that one place is worth which is nearer by the length of the place: things seldom go far."""
_LAB = ((0.0, 100.0), (-60.0, 60.0), (-60.0, 60.0))
_CELLS = (4, 10, 10)


@dataclass(frozen=True)
class LaterView:
    """A photo of another day in its place.

    Attributes:
        comparison: photo and scene from there.
        things: int32 [H, W], the thing that the scene shows at each pixel of the comparison, 0 for none.
    """

    comparison: Comparison
    things: NDArray[np.int32]


@dataclass(frozen=True)
class Region:
    """Where a photo shows an event.

    Attributes:
        view: row of the photo.
        kind: "missing" where only the scene has something, "new" where only the photo has.
        box: left, top, right, bottom, pixels of the comparison.
    """

    view: int
    kind: DifferenceKind
    box: tuple[int, int, int, int]


@dataclass(frozen=True)
class Change:
    """An event.

    Attributes:
        kind: "gone", "moved", "new" or "changed".
        thing: its id in the scene; 0 for what is new.
        views: rows of the photos that agree.
        probability: that something changed there.
        before, after: float64 [2, 3], lowest and highest corners, world frame, scene units; None where it was or is
            nowhere.
        regions: where the photos show it.
    """

    kind: ChangeKind
    thing: int
    views: tuple[int, ...]
    probability: float
    before: F64 | None
    after: F64 | None
    regions: tuple[Region, ...]


@dataclass(frozen=True)
class Changes:
    """What photos tell of a scene's things.

    Attributes:
        events: the surest first.
        seen: ids of the things that at least two photos should show.
    """

    events: tuple[Change, ...]
    seen: tuple[int, ...]


@dataclass(frozen=True)
class _Lost:
    thing: int
    views: tuple[int, ...]
    share: float


def find_changes(
    views: Sequence[LaterView], boxes: Mapping[int, F64], place: F64, surfaces: frozenset[int] = frozenset()
) -> Changes:
    """The events that at least two photos agree on.

    A thing is gone where the median photo does not have the colors of half of its pixels anywhere near. Something is
    new where space before the scene's surfaces, or on them, projects to colors that the scene has not, in all photos
    that look there; a shade of what the scene shows is none. What is gone here and new there, and looks alike, moved.

    Args:
        views: the photos that have a place.
        boxes: float64 [2, 3] of each thing, lowest and highest corners, scene units.
        place: float64 [2, 3], what is looked at, as boxes.
        surfaces: ids of floors, walls and tables, which neither go nor come.
    """
    lost_maps = [_differs(view.comparison.shown, view.comparison) for view in views]
    lost, seen = _lost(views, lost_maps, sorted(boxes), surfaces)
    taken = frozenset(each.thing for each in lost)
    found_maps = [_found(view, taken) for view in views]
    pieces = changed_pieces([view.comparison for view in views], found_maps, place)
    events = _events(views, lost, pieces, boxes, float((place[1] - place[0]).max()))
    return Changes(tuple(sorted(events, key=lambda event: -event.probability)), tuple(seen))


def _lost(
    views: Sequence[LaterView], maps: Sequence[Bools], things: Sequence[int], surfaces: frozenset[int]
) -> tuple[list[_Lost], list[int]]:
    shares: dict[int, list[tuple[int, float]]] = {thing: [] for thing in things}
    for row, (view, differs) in enumerate(zip(views, maps, strict=True)):
        ids = np.where(view.comparison.sure, view.things, 0)
        most = int(max(ids.max(initial=0), max(things, default=0))) + 1
        pixels = np.bincount(ids.ravel(), minlength=most)
        changed = np.bincount(ids[differs], minlength=most)
        for thing in things:
            if pixels[thing] >= _FEWEST_PIXELS:
                shares[thing].append((row, float(changed[thing] / pixels[thing])))
    seen = [thing for thing in things if len(shares[thing]) >= FEWEST_VIEWS]
    lost = []
    for thing in (each for each in seen if each not in surfaces):
        share = float(np.median([each for _, each in shares[thing]]))
        agreeing = tuple(row for row, each in shares[thing] if each >= _LOST_SHARE)
        if share >= _LOST_SHARE and len(agreeing) >= FEWEST_VIEWS:
            lost.append(_Lost(thing, agreeing, share))
    return lost, seen


def _events(
    views: Sequence[LaterView],
    lost: Sequence[_Lost],
    pieces: Sequence[ChangedPiece],
    boxes: Mapping[int, F64],
    length: float,
) -> list[Change]:
    left = list(range(len(pieces)))
    events: list[Change] = []
    here: dict[int, int] = {}
    for number, piece in enumerate(pieces):
        inside = [each.thing for each in lost if each.thing not in here and _inside(piece.box, boxes[each.thing])]
        if inside:
            here[inside[0]] = number
    looks = {each.thing: _thing_colors(views, each) for each in lost}
    pairs = [
        (
            _likeness(looks[each.thing], _piece_colors(views, pieces[number])),
            float(np.linalg.norm(boxes[each.thing].mean(axis=0) - pieces[number].box.mean(axis=0))),
            each,
            number,
        )
        for each in lost
        for number in left
        if number not in here.values() and _size_ratio(boxes[each.thing], pieces[number].box) <= _SIZE_RATIO
    ]
    moved: dict[int, int] = {}
    kind: ChangeKind
    for likeness, _, each, number in sorted(pairs, key=lambda pair: _NEARER * pair[1] / length - pair[0]):
        if likeness >= _ALIKE and each.thing not in moved and number in left:
            moved[each.thing] = number
            left.remove(number)
    for each in lost:
        box, sure, views_of = boxes[each.thing], _sure(len(each.views), each.share), each.views
        at = moved.get(each.thing, here.get(each.thing))
        regions = [Region(row, "missing", _around(views[row].things == each.thing)) for row in each.views]
        if at is None:
            events.append(Change("gone", each.thing, views_of, sure, box, None, tuple(regions)))
            continue
        piece = pieces[at]
        if each.thing in moved:
            sure, views_of = min(sure, _sure(len(piece.views), piece.share)), tuple(sorted({*views_of, *piece.views}))
        else:
            left.remove(at)
        kind = "moved" if each.thing in moved else "changed"
        events.append(Change(kind, each.thing, views_of, sure, box, piece.box, (*regions, *_regions(piece))))
    for number in left:
        piece = pieces[number]
        sure = _sure(len(piece.views), piece.share)
        events.append(Change("new", 0, piece.views, sure, None, piece.box, _regions(piece)))
    return events


def _regions(piece: ChangedPiece) -> tuple[Region, ...]:
    return tuple(Region(row, "new", _around(own)) for row, own in zip(piece.views, piece.pixels, strict=True))


def _around(pixels: Bools) -> tuple[int, int, int, int]:
    rows, columns = np.nonzero(pixels)
    return int(columns.min()), int(rows.min()), int(columns.max()) + 1, int(rows.max()) + 1


def _sure(views: int, share: float) -> float:
    """0..1, by how many photos agree, and how far."""
    return float(share * (1 - 0.5**views))


def _inside(piece: F64, thing: F64) -> bool:
    """Whether a piece lies mostly in a thing's box."""
    common = np.minimum(piece[1], thing[1]) - np.maximum(piece[0], thing[0])
    return bool((common > 0).all() and common.prod() >= 0.5 * np.maximum(piece[1] - piece[0], 1e-9).prod())


def _size_ratio(one: F64, other: F64) -> float:
    lengths = [max(float(np.linalg.norm(box[1] - box[0])), 1e-9) for box in (one, other)]
    return max(lengths) / min(lengths)


def _thing_colors(views: Sequence[LaterView], lost: _Lost) -> F64:
    return _histogram(
        [(view.comparison.shown, view.things == lost.thing) for row, view in enumerate(views) if row in lost.views]
    )


def _piece_colors(views: Sequence[LaterView], piece: ChangedPiece) -> F64:
    return _histogram([(views[row].comparison.photo, own) for row, own in zip(piece.views, piece.pixels, strict=True)])


def _histogram(parts: Sequence[tuple[F32, Bools]]) -> F64:
    """float64 [K], the CIELAB colors of pixels in cells, summing to 1: of brightness coarse ones, as light differs."""
    colors = np.concatenate([picture[own] for picture, own in parts]) if parts else np.zeros((0, 3), np.float32)
    if not len(colors):
        return np.zeros(int(np.prod(_CELLS)))
    lab = cv2.cvtColor(colors[None].astype(np.float32), cv2.COLOR_RGB2LAB)[0]
    counts, _ = np.histogramdd(lab.clip(*np.array(_LAB).T), bins=_CELLS, range=_LAB)
    return np.asarray(counts.ravel() / counts.sum(), np.float64)


def _likeness(one: F64, other: F64) -> float:
    """0..1, the coefficient of Bhattacharyya (1943) of two histograms."""
    return float(np.sqrt(one * other).sum())


def _differs(lacking: F32, comparison: Comparison) -> Bools:
    """bool [H, W]: where one of a comparison's pictures has a color that the other one has nowhere around."""
    other = comparison.photo if lacking is comparison.shown else comparison.shown
    around = np.ones((_SLACK_PX, _SLACK_PX), np.uint8)
    soft_one, soft_other = (cv2.GaussianBlur(picture.clip(0.0, 1.0), (0, 0), 1.0) for picture in (lacking, other))
    beyond = np.maximum(soft_one - cv2.dilate(soft_other, around), cv2.erode(soft_other, around) - soft_one)
    excess = np.maximum(beyond, 0.0).max(axis=2)
    if not comparison.sure.any():
        return np.zeros(excess.shape, np.bool_)
    usual = float(excess[comparison.sure].mean())
    return np.asarray((excess > max(_LEAST, _TIMES_USUAL * usual)) & comparison.sure)


def _found(view: LaterView, gone: frozenset[int]) -> tuple[Bools, Bools]:
    """bool [H, W] twice: where the photo shows what the scene has not, and where that cannot be told."""
    differs = _differs(view.comparison.photo, view.comparison) & ~_only_shaded(view.comparison)
    wide = np.ones((7, 7), np.uint8)
    left = cv2.dilate(np.isin(view.things, sorted(gone)).astype(np.uint8), wide) > 0
    unknown = left | _burnt(view.comparison) | ~view.comparison.sure
    return cv2.morphologyEx(differs.astype(np.uint8), cv2.MORPH_CLOSE, wide) > 0, unknown


def _burnt(comparison: Comparison) -> Bools:
    """Where the photo is as bright as it can be, and the scene bright: what it would show is not known."""
    burnt = (comparison.photo > _BURNT) & (comparison.shown > _BRIGHT)
    return cv2.dilate(np.asarray(burnt.any(axis=2), np.uint8), np.ones((3, 3), np.uint8)) > 0


def _only_shaded(comparison: Comparison) -> Bools:
    """Where the photo has the scene's color but for its brightness: a shadow that came or went."""
    photo, shown = (cv2.blur(picture, (_WINDOW_PX, _WINDOW_PX)) for picture in (comparison.photo, comparison.shown))
    gain = photo.sum(axis=2) / np.maximum(shown.sum(axis=2), 1e-3)
    rest = np.abs(photo - gain[..., None] * shown).max(axis=2)
    return np.asarray((gain > _SHADED[0]) & (gain < _SHADED[1]) & (rest < _SAME_CHROMA))
