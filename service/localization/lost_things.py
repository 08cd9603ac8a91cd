"""What a scene shows and later photos do not: its things, and what stood there without being one of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.localization.changed_space import FEWEST_VIEWS, changed_pieces
from fastsplat.service.localization.later_views import LaterView
from fastsplat.service.localization.photometric_refinement import Comparison

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

_FEWEST_PIXELS = 30
_SURE_SHARE = 0.5
"""Of a thing's pixels whose depth is sure: a view with fewer says nothing of it."""
_LOST_SHARE = 0.5
"""Of a thing's pixels that the photo does not show: the median over the photos that should show it."""
_BORDER_PX, _RING_PX, _MEAN_PX = 5, 13, 9
_ENOUGH = 0.05
_LEAST_STEP = 1e-3
_TOUCHING = np.ones((15, 15), np.uint8)
"""Pixels: what is 7 away still touches."""
STEPS = 2.5
"""Times the scene's step of color at a border from which on something else stands there: a dark gap between books steps
as much as the book did, what is new on a plain surface five times as much."""


@dataclass(frozen=True)
class Lost:
    """What is not where it was.

    Attributes:
        thing: its id; 0 for what is none of the scene's things.
        box: float64 [2, 3], lowest and highest corners, scene units.
        views: rows of the photos that agree.
        pixels: bool [H, W] of each of these, where the scene shows it.
        share: of its pixels that the photos do not show.
        step: how many times the photos' step of color at its border is the scene's: above `STEPS`, something else
            stands there.
    """

    thing: int
    box: F64
    views: tuple[int, ...]
    pixels: tuple[Bools, ...]
    share: float
    step: float


def lost_things(
    views: Sequence[LaterView], boxes: Mapping[int, F64], surfaces: frozenset[int]
) -> tuple[list[Lost], list[int]]:
    """The things of which the median photo does not have the colors of half of the pixels anywhere near; and the ids
    of those that at least two photos should show.

    Args:
        boxes: float64 [2, 3] of each thing.
        surfaces: ids of what neither goes nor comes.
    """
    shares: dict[int, list[tuple[int, float]]] = {thing: [] for thing in sorted(boxes)}
    most = max([*boxes, *(int(view.things.max(initial=0)) for view in views)], default=0) + 1
    for row, view in enumerate(views):
        ids = np.where(view.comparison.sure, view.things, 0)
        pixels, whole = (np.bincount(each.ravel(), minlength=most) for each in (ids, view.things))
        changed = np.bincount(ids[view.missing], minlength=most)
        for thing, own in shares.items():
            if pixels[thing] >= max(_FEWEST_PIXELS, _SURE_SHARE * whole[thing]):
                own.append((row, float(changed[thing] / pixels[thing])))
    seen = [thing for thing, own in shares.items() if len(own) >= FEWEST_VIEWS]
    lost = []
    for thing in (each for each in seen if each not in surfaces):
        share = float(np.median([each for _, each in shares[thing]]))
        agreeing = tuple(row for row, each in shares[thing] if each >= _LOST_SHARE)
        if share >= _LOST_SHARE and len(agreeing) >= FEWEST_VIEWS:
            own_pixels = tuple(views[row].things == thing for row in agreeing)
            step = step_ratio(agreeing, own_pixels, views)
            lost.append(Lost(thing, boxes[thing], agreeing, own_pixels, share, step))
    return lost, seen


def lost_pieces(views: Sequence[LaterView], lost: Sequence[Lost], place: F64) -> list[Lost]:
    """Pieces of the scene's surfaces whose colors the photos do not have, and at whose border the color steps in the
    scene, too, but not many times more in the photos: there stood something that is none of its things.

    Args:
        lost: things, whose pixels are explained.
        place: float64 [2, 3], which space.
    """
    comparisons = [view.comparison for view in views]
    maps = [
        (view.only_in_scene, view.unknown(aside, view.comparison.sure))
        for view, aside in zip(views, pixels_of(views, lost), strict=True)
    ]
    found = []
    for piece in changed_pieces(comparisons, maps, place, on_surface=True):
        step = step_ratio(piece.views, piece.pixels, views)
        if step < STEPS:
            found.append(Lost(0, piece.box, piece.views, piece.pixels, piece.share, step))
    return found


def whole(lost: Sequence[Lost]) -> list[Lost]:
    """Without the pieces that touch a thing, or a piece before them, in half of the photos that show both: one thing is
    often several of the scene's, or more than one of them."""
    kept: list[Lost] = []
    for one in lost:
        if one.thing or not any(_touches(one, other) for other in kept):
            kept.append(one)
    return kept


def _touches(one: Lost, other: Lost) -> bool:
    pixels = dict(zip(other.views, other.pixels, strict=True))
    both = [(own, pixels[view]) for view, own in zip(one.views, one.pixels, strict=True) if view in pixels]
    touching = [bool((cv2.dilate(own.astype(np.uint8), _TOUCHING)[its] > 0).any()) for own, its in both]
    return bool(both) and 2 * sum(touching) >= len(both)


def pixels_of(views: Sequence[LaterView], lost: Sequence[Lost]) -> list[Bools]:
    """bool [H, W] of each photo: where the scene shows what is lost; of what is no thing, all surface in its box."""
    taken = sorted({each.thing for each in lost if each.thing})
    boxes = [each.box for each in lost if not each.thing]
    maps = [np.isin(view.things, taken) for view in views]
    for view, own in zip(views, maps, strict=True):
        points = _surface(view.comparison) if boxes else np.zeros(0)
        for low, high in boxes:
            own |= ((points >= low) & (points <= high)).all(axis=2)
    return maps


def _surface(comparison: Comparison) -> F64:
    """float64 [H, W, 3]: the point that each pixel shows, world frame; not a number where nothing is."""
    depth, pose = np.where(comparison.depth > 0, comparison.depth, np.nan), comparison.posed.world_from_camera
    rows, columns = np.indices(depth.shape) + 0.5
    local = comparison.posed.camera.rays(columns, rows) * depth[..., None]
    return np.asarray(local @ pose[:3, :3].T + pose[:3, 3], np.float64)


def step_ratio(rows: Sequence[int], pixels: Sequence[Bools], views: Sequence[LaterView]) -> float:
    """How many times the photos' step of color at a region's border is that of the scene, the median photo; 1 where
    nothing around it is as it was.

    Args:
        pixels: bool [H, W] of each of these, the region.
        views: all photos.
    """
    ratios = []
    for row, own in zip(rows, pixels, strict=True):
        pictures = views[row].comparison.photo, views[row].comparison.shown
        in_photo, in_scene = (_step(each, own, views[row].same) + _LEAST_STEP for each in pictures)
        ratios.append(in_photo / in_scene)
    return float(np.median(ratios))


def _step(picture: F32, own: Bools, free: Bools) -> float:
    """The difference, 0..1, between a region's colors and those around it, of local means, that three quarters of its
    border exceed: a thing has a border all around, and a pattern has edges somewhere on any.

    Args:
        picture: float32 [H, W, 3].
        own: bool [H, W], the region.
        free: bool [H, W], what around it counts.
    """
    region = own.astype(np.uint8)
    near = cv2.dilate(region, np.ones((_BORDER_PX, _BORDER_PX))) > 0
    around = (cv2.dilate(region, np.ones((_RING_PX, _RING_PX))) > 0) & ~near & free
    inner = cv2.erode(region, np.ones((3, 3))) > 0
    (inside, weight), (outside, weight_out) = (_local_mean(picture, part) for part in (own, around))
    border = near & ~inner & (weight > _ENOUGH) & (weight_out > _ENOUGH)
    return float(np.quantile(np.abs(inside - outside).max(axis=2)[border], 0.25)) if border.any() else 0.0


def _local_mean(picture: F32, part: Bools) -> tuple[F32, F32]:
    """float32 [H, W, 3] and [H, W]: the mean of a part of a picture around each pixel, and how much of it is there."""
    size = _MEAN_PX, _MEAN_PX
    weight = cv2.blur(part.astype(np.float32), size)
    mean = cv2.blur(picture * part[..., None], size) / np.maximum(weight, 1e-6)[..., None]
    return np.asarray(mean, np.float32), np.asarray(weight, np.float32)
