"""Where to prompt: on a grid in the views seen first, then on each thing once and where nothing is explained."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.mask_proposals import grid_points

F64 = NDArray[np.float64]


def dense_views(count: int, dense: int) -> list[int]:
    """Positions of at most `dense` of `count` views, evenly spread."""
    if dense >= count:
        return list(range(count))
    return sorted({int(position) for position in (np.arange(dense) + 0.5) * count / max(dense, 1)})


def guided_points(owners: NDArray[np.integer], across: int, max_unexplained: int, min_pixels: int) -> F64:
    """float64 [K, 2] x and y: one point inside each thing that a view shows, where it is widest, and grid points where
    no thing is.

    Args:
        owners: int [H, W], the thing that each pixel shows, 1 the first, 0 for none.
        across: grid points along the longer side.
        max_unexplained: grid points at most, evenly taken.
        min_pixels: things that show fewer pixels are left out.
    """
    height, width = owners.shape
    points = []
    for number in np.unique(owners[owners > 0]):
        mask = owners == number
        if mask.sum() >= min_pixels:
            padded = np.pad(mask.astype(np.uint8), 1)  # the picture's edge is an edge of the thing
            depth = cv2.distanceTransform(padded, cv2.DIST_L2, 3)[1:-1, 1:-1]
            row, column = np.unravel_index(int(depth.argmax()), depth.shape)
            points.append((column + 0.5, row + 0.5))
    grid = grid_points(width, height, across)
    free = grid[owners[grid[:, 1].astype(np.intp), grid[:, 0].astype(np.intp)] == 0]
    if len(free) > max_unexplained:
        free = free[np.linspace(0, len(free) - 1, max_unexplained).round().astype(np.intp)]
    return np.concatenate([np.array(points, np.float64).reshape(-1, 2), free])
