"""Order of views in which few of them show most of the place."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.captures import Capture, View
from fastsplat.service.perception.results import Labelling

_TIMES = 2  # a point counts in this many views, as an object needs two
_MOST_POINTS = 4_000


EARLY_VIEWS = 8
"""Number of views that are looked at first, for a draft of the scene."""

ShowEarly = Callable[[Labelling, Sequence[int]], None]
"""Called with the labelling so far and the numbers of its views, at most `EARLY_VIEWS`."""


def covering_order(capture: Capture, numbers: Sequence[int]) -> list[int]:
    """Sorts views so that each adds as many points of the capture as possible.

    Points count in their first two views; views that add nothing keep their order at the end.
    """
    points = capture.points
    if len(points) > _MOST_POINTS:
        points = points[np.sort(np.random.default_rng(0).choice(len(points), _MOST_POINTS, replace=False))]
    inside = {number: _shows(capture.views[number], points) for number in numbers}
    seen, left, order = np.zeros(len(points), np.int64), list(numbers), []
    while left:
        best = max(left, key=lambda number: (int((inside[number] & (seen < _TIMES)).sum()), -left.index(number)))
        order.append(best)
        left.remove(best)
        seen += inside[best]
    return order


def _shows(view: View, points: NDArray[np.float32]) -> NDArray[np.bool_]:
    """bool [P]: points inside a view's picture, ignoring occlusion."""
    inside = np.zeros(len(points), np.bool_)
    inside[view.posed.in_picture(points)[0]] = True
    return inside
