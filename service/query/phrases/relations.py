"""Spatial relations between objects from their Gaussians, with clearness.

Every bound has an undecided range beside it. Lengths are relative to the sizes of the objects, so that they work
without a known scale."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.query.objects.object_measures import ObjectShape
from fastsplat.service.query.phrases.phrases import RelationKind
from fastsplat_contract.messages.phrases import RefusalReason

F64 = NDArray[np.float64]

NEED_VERTICAL: frozenset[RelationKind] = frozenset({"on", "in", "under", "above", "next_to"})

_MOST = 10.0
_SECTORS = 16
_SPACINGS = 3.0
_SURFACES = (0.5, 0.75, 0.95)
_STRAYS = 0.2
"""Least share of an object's points that makes a surface."""
_LEVEL = 0.17
"""Sine of the angle to the vertical below which a direction has no side."""
_REST = 0.12
"""Tolerance of contact, as a share of an object's height or width."""
_REST_DEVIATIONS = 2.0


class Measured(NamedTuple):
    """One measurement, see `Witness`; `unit` "length" is the scene's."""

    measure: str
    value: float
    unit: str
    clearness: float


@dataclass(frozen=True)
class Judged:
    """Judgement of a condition."""

    clearness: float  # from 1 on it holds, from -1 on it does not, between nothing is decided
    measured: tuple[Measured, ...] = ()  # by what
    reason: RefusalReason = "too_close"  # why, if nothing is decided


@dataclass(frozen=True)
class Asker:
    """Pose of the asker, in the axes of the shapes."""

    position: F64  # float64 [3]
    forward: F64  # float64 [3], where the asker looks, unit length
    right: F64  # float64 [3], level, unit length
    up: F64  # float64 [3], the vertical, or the asker's own where the scene does not tell it


def asker_at(world_from_camera: F64, axes: F64, vertical: bool) -> Asker:
    """Makes an asker from a camera pose [4, 4], OpenCV axes, world from camera.

    `axes`, float64 [3, 3], has the axes of shapes in rows; `vertical`: the last one is up."""
    pose = axes @ world_from_camera[:3]
    up = np.array([0.0, 0.0, 1.0]) if vertical else -pose[:, 1]
    right = np.cross(pose[:, 2], up)
    if np.linalg.norm(right) < _LEVEL:  # looks straight down or up
        right = pose[:, 0] - (pose[:, 0] @ up) * up
    return Asker(pose[:, 3], pose[:, 2], right / max(float(np.linalg.norm(right)), 1e-12), up)


def clearness(value: float, holds: float, fails: float) -> float:
    """Linear clearness: 1 at the bound `holds`, -1 at `fails`, clipped to ±10."""
    return float(np.clip((value - (holds + fails) / 2) / ((holds - fails) / 2), -_MOST, _MOST))


def all_of(*measured: Measured) -> Judged:
    """Conjunction: as clear as the least clear measurement."""
    return Judged(min(measurement.clearness for measurement in measured), measured)


def gap_between(first: ObjectShape, second: ObjectShape) -> float:
    """Distance between the surfaces of two objects."""
    small, large = sorted((first, second), key=lambda shape: len(shape.points))
    return float(large.tree.query(small.points)[0].min())


def is_on(subject: ObjectShape, anchor: ObjectShape) -> Judged:
    """Judges if one object rests on another's surface, but not in it."""
    overlap = _overlap(subject, anchor)
    surface = _surface_below(subject, anchor)
    if surface is None:
        return all_of(_share(overlap), Measured("gap", subject.low - anchor.high, "length", -_MOST))
    tolerance = _tolerance(subject, anchor)
    gap = subject.low - surface
    rests = Measured("gap", gap, "length", clearness(abs(gap), tolerance, 2 * tolerance))
    judged = all_of(_share(overlap), rests)
    if judged.clearness > -1 and (inside := is_in(subject, anchor)).clearness > -1:
        return Judged(min(judged.clearness, -inside.clearness), (*judged.measured, *inside.measured))
    return judged


def is_in(subject: ObjectShape, anchor: ObjectShape) -> Judged:
    """Judges if one object is within another's outline, below its rim and walled in."""
    overlap = _share_inside(subject, anchor)
    depth = (anchor.high - subject.low) / max(subject.high - subject.low, np.finfo(np.float64).tiny)
    middle = np.median(subject.points[:, :2], axis=0)
    higher = anchor.points[:, 2] > subject.low + 0.25 * (subject.high - subject.low)
    beside = anchor.points[higher & (anchor.points[:, 2] < subject.high)][:, :2] - middle
    sectors = np.floor((np.arctan2(beside[:, 1], beside[:, 0]) / (2 * np.pi) + 0.5) * _SECTORS).astype(int) % _SECTORS
    enclosed = len(np.unique(sectors)) / _SECTORS if higher.mean() > _STRAYS else 0.0
    return all_of(
        Measured("overlap", overlap, "share", clearness(overlap, 0.7, 0.4)),
        Measured("depth", depth, "ratio", clearness(depth, 0.25, 0.1)),
        Measured("enclosure", enclosed, "share", clearness(enclosed, 0.7, 0.45)),
    )


def is_under(subject: ObjectShape, anchor: ObjectShape) -> Judged:
    """Judges if one object is below another, with overlapping outlines."""
    overlap = _overlap(subject, anchor)
    over = _around(anchor, subject)
    above = over[over > (subject.low + subject.high) / 2]
    if len(above) <= _STRAYS * len(over):
        return all_of(_share(overlap), Measured("gap", anchor.low - subject.high, "length", -_MOST))
    gap = float(np.quantile(above, 0.05)) - subject.high
    tolerance = _tolerance(subject, anchor)
    judged = all_of(_share(overlap), Measured("gap", gap, "length", clearness(gap, -tolerance, -2 * tolerance)))
    if judged.clearness > -1 and (inside := is_in(subject, anchor)).clearness > -1:
        return Judged(min(judged.clearness, -inside.clearness), (*judged.measured, *inside.measured))
    return judged


def is_next_to(subject: ObjectShape, anchor: ObjectShape) -> Judged:
    """Judges if two objects are near for their sizes, level, and not stacked."""
    gap = gap_between(subject, anchor)
    ratio = gap / _common_size(subject, anchor)
    heights = min(subject.high - subject.low, anchor.high - anchor.low)
    level = (min(subject.high, anchor.high) - max(subject.low, anchor.low)) / max(heights, np.finfo(np.float64).tiny)
    overlap = _overlap(subject, anchor)
    return all_of(
        Measured("gap", gap, "length", clearness(ratio, 0.6, 1.2)),
        Measured("level", level, "share", clearness(level, 0.3, 0.05)),
        Measured("overlap", overlap, "share", clearness(overlap, 0.3, 0.6)),
    )


def is_near(subject: ObjectShape, anchor: ObjectShape) -> Judged:
    """Judges if two objects are near each other for their sizes."""
    gap = gap_between(subject, anchor)
    return all_of(Measured("gap", gap, "length", clearness(gap / _common_size(subject, anchor), 1.0, 2.0)))


def is_between(subject: ObjectShape, first: ObjectShape, second: ObjectShape, level: bool) -> Judged:
    """Judges if an object is between others: a nearly straight angle between their nearest places."""
    count = 2 if level else 3
    middle = subject.points[:, :count].mean(axis=0)
    towards = []
    for end in (first, second):
        offsets = end.points[:, :count] - middle
        offset = offsets[(offsets**2).sum(axis=1).argmin()]
        towards.append(offset / max(float(np.linalg.norm(offset)), np.finfo(np.float64).tiny))
    angle = float(np.degrees(np.arccos(np.clip(towards[0] @ towards[1], -1.0, 1.0))))
    return all_of(Measured("angle", angle, "deg", clearness(angle, 145.0, 115.0)))


def is_seen(kind: RelationKind, subject: ObjectShape, anchor: ObjectShape | None, asker: Asker) -> Judged:
    """Judges left, right, in front and behind as the asker sees them.

    Directions are level and relative to the line from the asker to the other object: left and right as in the asker's
    picture, in front is nearer. Offsets are relative to the sizes of the objects in that direction. If `anchor` is None
    it is the asker: in front is where the asker looks."""
    start = asker.position if anchor is None else anchor.points.mean(axis=0)
    line = asker.forward if anchor is None else start - asker.position
    line = line - (line @ asker.up) * asker.up
    length = float(np.linalg.norm(line))
    if length < 1e-9 or (anchor is not None and not _in_front(asker, subject, anchor, length)):
        return Judged(0.0, (), "out_of_view")
    forward = line / length
    right = np.cross(forward, asker.up)
    across, along = (_offset(subject, anchor, start, axis) for axis in (right, forward))
    toward = -along if (kind == "in_front_of") != (anchor is None) else along
    direction, aside = {"left_of": (-across, along), "right_of": (across, along)}.get(kind, (toward, across))
    angle = float(np.degrees(np.arctan2(abs(aside), direction)))
    return all_of(
        Measured("offset", direction, "ratio", clearness(direction, 0.8, 0.4)),
        Measured("direction", angle, "deg", clearness(angle, 55.0, 75.0)),
    )


PAIRS: Mapping[RelationKind, Callable[[ObjectShape, ObjectShape], Judged]] = {
    "on": is_on,
    "in": is_in,
    "under": is_under,
    "above": lambda subject, anchor: is_under(anchor, subject),
    "next_to": is_next_to,
    "near": is_near,
}
"""Relations between two objects that do not depend on the asker."""


def _in_front(asker: Asker, subject: ObjectShape, anchor: ObjectShape, length: float) -> bool:
    """True if both are ahead of an asker outside of the other one."""
    ahead = [float((shape.points.mean(axis=0) - asker.position) @ asker.forward) for shape in (subject, anchor)]
    return min(ahead) > 0 and length > anchor.width / 2


def _offset(subject: ObjectShape, anchor: ObjectShape | None, start: F64, axis: F64) -> float:
    """Offset of centers along an axis, in sums of half extents."""
    ends = [np.quantile(shape.points @ axis, [0.02, 0.98]) for shape in (subject, anchor) if shape is not None]
    middles = [float(low + high) / 2 for low, high in ends]
    half = sum(float(high - low) / 2 for low, high in ends)
    second = float(start @ axis) if anchor is None else middles[1]
    return (middles[0] - second) / max(half, np.finfo(np.float64).tiny)


def _common_size(first: ObjectShape, second: ObjectShape) -> float:
    """Geometric mean of the boxes' diagonals, so that long walls do not dominate."""
    sizes = float(np.linalg.norm(first.size)) * float(np.linalg.norm(second.size))
    return max(float(np.sqrt(sizes)), np.finfo(np.float64).tiny)


def _overlap(first: ObjectShape, second: ObjectShape) -> float:
    """Larger share of one object's points within the other's outline."""
    return max(_share_inside(first, second), _share_inside(second, first))


def _share_inside(subject: ObjectShape, anchor: ObjectShape) -> float:
    return float((anchor.outside(subject.points[:, :2]) <= 0).mean())


def _share(overlap: float) -> Measured:
    return Measured("overlap", overlap, "share", clearness(overlap, 0.4, 0.15))


def _tolerance(first: ObjectShape, second: ObjectShape) -> float:
    slack = _REST * min(first.high - first.low, first.width)
    return max(slack, _REST_DEVIATIONS * max(first.deviation, second.deviation), np.finfo(np.float64).tiny)


def _around(subject: ObjectShape, anchor: ObjectShape) -> F64:
    """Heights of an object's points in the other's outline, or half its width around.

    The surface right below an object is unseen."""
    reach = max(anchor.width / 2, _SPACINGS * subject.spacing)
    return np.asarray(subject.points[anchor.outside(subject.points[:, :2]) <= reach, 2])


def _surface_below(subject: ObjectShape, anchor: ObjectShape) -> float | None:
    """Height of the other's surface around and below one object; None for none.

    The nearest of several quantiles, as the highest points may be strays."""
    heights = _around(anchor, subject)
    below = heights[heights < (subject.low + subject.high) / 2]
    if len(below) > _STRAYS * len(heights):
        surfaces = np.quantile(below, _SURFACES)
        return float(surfaces[np.abs(surfaces - subject.low).argmin()])
    return anchor.high if anchor.high < (subject.low + subject.high) / 2 and _overlap(subject, anchor) > 0 else None


def negated(judged: Judged, denied: bool) -> Judged:
    """Negates a judgement if the phrase denies it."""
    if not denied:
        return judged
    measured = tuple(measurement._replace(clearness=-measurement.clearness) for measurement in judged.measured)
    return Judged(-judged.clearness, measured, judged.reason)
