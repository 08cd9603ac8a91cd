"""What a capture's photos saw of a place where something was in another capture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.query.things.unseen_space import hiding_points, opaque_rows
from fastsplat.service.query.things.visibility import SightLines, spread_views
from fastsplat.service.scene.types import Scene

PlaceSight = Literal["unseen", "filled", "empty"]

_SLACK = 0.02
"""Of the distance: what is no further than this before or behind a place is at it. Depths of trained scenes are right
to about that."""


def place_sights(scene: Scene, places: Sequence[NDArray[np.float64]]) -> tuple[PlaceSight, ...]:
    """Of each place whether photos of a scene show it, and whether it is empty there.

    A point is empty where most of the photos that see it see something opaque further away in its direction, and filled
    where they see that at it; what is hidden, outside of all pictures, or before nothing is unseen. A place is empty
    where half of its points are, otherwise filled where a quarter is, as a thing hides its own back, otherwise unseen.

    Args:
        scene: its cameras and Gaussians.
        places: of each float64 [K, 3], K at least 1, world frame: what was there, as another capture in the same frame
            has it.
    """
    if not places:
        return ()
    rows = opaque_rows(scene)
    opaque, _ = hiding_points(scene, rows, np.zeros(len(rows), np.int32))
    points = np.concatenate(places)
    empty, filled = np.zeros((2, len(points)), np.int64)
    for posed in spread_views(scene.cameras):
        sight = SightLines(posed, opaque)
        cell, depth, ahead = sight.cells(points)
        nearest = sight.nearest[cell]
        filled[ahead[np.abs(nearest - depth) <= _SLACK * depth]] += 1
        empty[ahead[np.isfinite(nearest) & (nearest > depth * (1 + _SLACK))]] += 1
    is_empty, is_filled = empty > filled, (filled > 0) & (filled >= empty)
    ends = np.cumsum([len(place) for place in places])[:-1]
    return tuple(map(_sight, np.split(is_empty, ends), np.split(is_filled, ends)))


def _sight(empty: NDArray[np.bool_], filled: NDArray[np.bool_]) -> PlaceSight:
    if 2 * empty.sum() >= len(empty):
        return "empty"
    return "filled" if 4 * filled.sum() >= len(filled) else "unseen"
