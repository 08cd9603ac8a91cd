"""Where a segmenter is prompted by points: in what no mask explains yet, and in what only a large mask has."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

_LEAST_RADIUS = 2.0
"""Pieces that reach no farther from their edge are left alone, in steps of the segmenter's grid: gaps between masks. A
pencil on a table reaches farther: the table's mask has a hole of its shape."""
_APART, _LEAST_APART = 1.5, 24
"""Points of a round in one piece keep this share of the distance to its edge from each other, and so many steps."""
_ANSWERED = 3
"""Steps of the grid around a prompt that no later round prompts again, whatever the answer was."""
_SMALL = 0.05
"""Masks that fill less of the image are one object, or a part of one: what lies in them is not prompted again."""


class CutImage:
    """How masks cut the image into pieces, and which of the pieces need no prompt.

    Attributes:
        pieces: int64 [h, w]: pixels that lie in the same masks have the same number, those in none have 0.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.pieces = np.zeros(shape, np.int64)
        self._small = np.zeros(shape, np.bool_)
        self._random = np.random.default_rng(0)

    def add(self, masks: NDArray[np.bool_]) -> None:
        """Cut the pieces by bool [P, h, w]."""
        small = masks.mean(axis=(1, 2)) < _SMALL
        self._small |= masks[small].any(axis=0)
        for mask in masks:  # sums of random numbers tell sets of masks apart
            self.pieces[mask] += self._random.integers(1, 1 << 56)

    def answered(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """bool [h, w]: what lies in a small mask, in a piece that [K, 2] `points` prompted, or near such a point."""
        columns, rows = points.astype(int).T
        prompted = self.pieces[rows, columns]
        result = self._small | np.isin(self.pieces, prompted[prompted != 0])
        for x, y in zip(columns, rows, strict=True):
            result[max(0, y - _ANSWERED) : y + _ANSWERED + 1, max(0, x - _ANSWERED) : x + _ANSWERED + 1] = True
        return np.asarray(result)


def open_points(pieces: NDArray[np.integer[Any]], answered: NDArray[np.bool_], count: int) -> NDArray[np.float64]:
    """float64 [K, 2] x and y, K at most `count`: the points of int [h, w] `pieces` farthest from the edges of piece and
    image, the farthest first, none where bool [h, w] is `answered`; those of one connected piece are kept apart."""
    inner = ~answered
    inner[1:] &= pieces[1:] == pieces[:-1]
    inner[:, 1:] &= pieces[:, 1:] == pieces[:, :-1]
    padded = np.pad(inner.astype(np.uint8), 1)  # the image's edge is an edge
    depth = cv2.distanceTransform(padded, cv2.DIST_L2, 3)[1:-1, 1:-1]
    connected = cv2.connectedComponents(inner.astype(np.uint8), connectivity=4)[1]
    points: list[tuple[float, float]] = []
    while len(points) < count:
        row, column = np.unravel_index(int(depth.argmax()), depth.shape)
        radius = float(depth[row, column])
        if radius < _LEAST_RADIUS:
            break
        points.append((column + 0.5, row + 0.5))
        around = np.zeros(depth.shape, np.uint8)
        cv2.circle(around, (int(column), int(row)), math.ceil(max(_LEAST_APART, _APART * radius)), 1, cv2.FILLED)
        depth[(around > 0) & (connected == connected[row, column])] = 0
    return np.array(points, np.float64).reshape(-1, 2)
