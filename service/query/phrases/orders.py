"""Orders and comparisons: the largest, the nearest, the second from the left; large things."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from fastsplat.service.query.phrases.phrases import OrderKind, SizeKind
from fastsplat.service.query.phrases.relations import Asker, Judged, Measured, clearness, gap_between
from fastsplat.service.query.things.thing_measures import ThingShape

_RATIO = float(np.log(1.1))
"""Least log ratio at which sizes or distances differ."""
_LARGE, _NOT_LARGE = float(np.log(1.3)), float(np.log(1.1))
_CLOSEST = 0.5
"""Clearness by which the closest color must lead."""
_APART = 0.5
"""Share of two things' half widths below which they overlap in the picture."""

NEED_LEVEL: frozenset[str] = frozenset({"height", "width", "elevation"})

_SIZES: Mapping[str, Callable[[ThingShape], tuple[float, ...]]] = {
    "size": lambda shape: (float(np.linalg.norm(shape.size)), float(np.prod(shape.size)) ** (1 / 3)),
    "height": lambda shape: (shape.high - shape.low,),
    "length": lambda shape: (max(shape.size),),
    "width": lambda shape: (shape.size[0],),
}
"""Measures by size; "size" has two, and the largest must be so by both.

The two are the diagonal and the cube root of the volume; their average must be clear enough."""


def is_large(by: SizeKind, more: bool, one: ThingShape, others: Sequence[ThingShape]) -> Judged:
    """Judges if a thing is large (or small) compared with the median of the others."""
    if not others:
        return Judged(0.0, (), "nothing_to_compare")
    own, rest = np.array(_SIZES[by](one)), np.array([_SIZES[by](other) for other in others])
    ratios = np.log(np.maximum(own, 1e-12) / np.maximum(np.median(rest, axis=0), 1e-12)) * (1 if more else -1)
    measured = tuple(
        Measured(by, float(value), "length", clearness(float(ratio), _LARGE, _NOT_LARGE))
        for value, ratio in zip(own, ratios, strict=True)
    )
    least, most = min(each.clearness for each in measured), max(each.clearness for each in measured)
    return Judged(least if least > 0 else min(most, 0.0), measured)


def closest_in_color(clear: Mapping[int, float], among: int, anything: bool) -> tuple[int, ...]:
    """Ids of things closest to a color none clearly has, closest first; else empty.

    `clear` has the clearness of those of `among` things that are not denied the color; `anything`: of any kind."""
    most = max(clear.values(), default=1.0)
    near = sorted(clear, key=lambda each: -clear[each])
    if 0 < most < 1:
        return tuple(each for each in near if clear[each] > max(most - _CLOSEST, 0.0))
    only = anything or (len(near) == 1 and among > 1)  # the others of its kind are denied the color
    return tuple(near) if only and most < 0 else ()


def ranked(
    by: OrderKind,
    descending: bool,
    number: int,
    shapes: Sequence[ThingShape],
    anchors: Sequence[ThingShape],
    asker: Asker | None,
) -> tuple[int | None, Judged]:
    """Index in `shapes` of the requested one (None if too few), and its clearness.

    `number` 1 is the first. A distance is to the nearest of `anchors`, without them to the asker."""
    if number > len(shapes):
        return None, Judged(10.0)
    if by == "from_left":
        assert asker is not None
        return _from_left(descending, number, shapes, asker)
    values = np.array([_values(by, shape, anchors, asker) for shape in shapes])
    keys = -values if descending else values
    orders = keys.argsort(axis=0, kind="stable")
    place = int(orders[number - 1, 0])
    measured = []
    for column in range(values.shape[1]):
        order = orders[:, column].tolist()
        beside = [order[at] for at in (number - 2, number) if 0 <= at < len(order)]
        value = float(values[place, column])
        if by == "elevation":
            apart = [
                2 * abs(value - float(values[other, 0])) / _heights(shapes[place], shapes[other]) for other in beside
            ]
        else:
            apart = [_log_ratio(value, float(values[other, column])) / _RATIO for other in beside]
        clear = min((min(each, 10.0) for each in apart), default=10.0)
        clear = clear if order[number - 1] == place else -0.5
        measured.append(Measured(by, value, "length", clear))
    clears = [each.clearness for each in measured]
    clear = float(np.mean(clears)) if min(clears) >= 0 else min(clears)
    return place, Judged(clear if clear >= 1 else min(clear, 0.99), tuple(measured))


def _heights(one: ThingShape, other: ThingShape) -> float:
    """Mean height of two things; the scale of differences in elevation."""
    return max((one.high - one.low + other.high - other.low) / 2, 1e-12)


def _log_ratio(one: float, other: float) -> float:
    return abs(float(np.log(max(one, 1e-9) / max(other, 1e-9))))


def _values(by: OrderKind, shape: ThingShape, anchors: Sequence[ThingShape], asker: Asker | None) -> tuple[float, ...]:
    if by in _SIZES:
        return _SIZES[by](shape)
    if by == "elevation":
        return (float(shape.center[2]),)
    if anchors:
        others = [anchor for anchor in anchors if anchor.id != shape.id]
        if not others:
            return (0.0, 0.0)
        return (
            min(gap_between(shape, other) for other in others),
            min(float(np.linalg.norm(shape.center - other.center)) for other in others),
        )
    assert asker is not None
    nearest = float(shape.tree.query(asker.position)[0])
    return nearest, float(np.linalg.norm(shape.center - asker.position))


def _from_left(descending: bool, number: int, shapes: Sequence[ThingShape], asker: Asker) -> tuple[int | None, Judged]:
    """Orders things as in the asker's picture."""
    ends = []
    for shape in shapes:
        offsets = shape.points - asker.position
        ahead = offsets @ asker.forward
        if np.median(ahead) <= 0:
            return None, Judged(0.0, (), "out_of_view")
        ends.append(np.quantile((offsets @ asker.right)[ahead > 0] / ahead[ahead > 0], [0.02, 0.98]))
    middles = np.array([low + high for low, high in ends]) / 2
    halves = np.array([high - low for low, high in ends]) / 2
    order = (-middles if descending else middles).argsort(kind="stable").tolist()
    place = order[number - 1]
    beside = [order[at] for at in (number - 2, number) if 0 <= at < len(order)]
    gaps = [
        abs(middles[place] - middles[other]) / max(_APART * (halves[place] + halves[other]), 1e-12) for other in beside
    ]
    clear = min((float(gap) for gap in gaps), default=10.0)
    angle = float(np.degrees(np.arctan(middles[place])))
    return place, Judged(min(clear, 10.0), (Measured("direction", angle, "deg", min(clear, 10.0)),))
