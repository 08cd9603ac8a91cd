"""What a capture's photos saw of a place where something was in another capture."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.query.things.solid_gaussians import solid_rows
from fastsplat.service.query.things.unseen_space import hiding_points
from fastsplat.service.query.things.visibility import SightLines, spread_views
from fastsplat.service.scene.types import Scene

PlaceSight = Literal["unseen", "filled", "empty"]

_SLACK = 0.02
"""Of the distance: what is no further than this before or behind a place is at it. Depths of trained scenes are right
to about that."""
_MAX_POINTS = 65_536


def place_sight(scene: Scene, points: NDArray[np.float64]) -> PlaceSight:
    """Whether photos of a scene show a place, and whether it is empty there.

    A point is empty where most of the photos that see it see something opaque further away in its direction, and filled
    where they see that at it; what is hidden, outside of all pictures, or before nothing is unseen. The place is empty
    where half of the points are, otherwise filled where a quarter is, as a thing hides its own back, otherwise unseen.

    Args:
        scene: its cameras and Gaussians.
        points: float64 [K, 3], K at least 1, world frame: what was there, as another capture in the same frame has it.
    """
    rows = solid_rows(scene.gaussians)
    rows = rows[scene.gaussians.logit_opacities[rows] > 0]
    rows = rows[:: -(-len(rows) // _MAX_POINTS) or 1]
    opaque, _ = hiding_points(scene, rows, np.zeros(len(rows), np.int32))
    empty, filled = np.zeros((2, len(points)), np.int64)
    for posed in spread_views(scene.cameras):
        sight = SightLines(posed, opaque)
        cell, depth, ahead = sight.cells(points)
        nearest = sight.nearest[cell]
        filled[ahead[np.abs(nearest - depth) <= _SLACK * depth]] += 1
        empty[ahead[np.isfinite(nearest) & (nearest > depth * (1 + _SLACK))]] += 1
    if 2 * (empty > filled).sum() >= len(points):
        return "empty"
    return "filled" if 4 * ((filled > 0) & (filled >= empty)).sum() >= len(points) else "unseen"
