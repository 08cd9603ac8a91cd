"""Point prompts in areas that no mask, or only a large one, explains."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

_LEAST_RADIUS = 2.0
"""Least grid steps to the edge of a piece: smaller ones are gaps between masks.

A pencil on a table reaches farther: the table's mask has a hole of its shape.
"""
_APART, _LEAST_APART = 1.5, 24  # points keep this share of their distance to the edge from each other; least steps
_ANSWERED = 3  # grid steps around a prompt that are not prompted again, whatever the answer
_SMALL = 0.05  # masks with a smaller share of the image are objects or parts, not prompted inside again


class CutImage:
    """An image cut into pieces by masks, with pieces that need no prompt.

    In `pieces`, int64 [h, w], pixels in the same masks have the same number, those in none 0.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.pieces = np.zeros(shape, np.int64)
        self._small = np.zeros(shape, np.bool_)
        self._random = np.random.default_rng(0)

    def add(self, masks: NDArray[np.bool_]) -> None:
        """Cuts the pieces by masks, bool [P, h, w]."""
        small = masks.mean(axis=(1, 2)) < _SMALL
        self._small |= masks[small].any(axis=0)
        for mask in masks:  # sums of random numbers tell sets of masks apart
            self.pieces[mask] += self._random.integers(1, 1 << 56)

    def answered(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """bool [h, w]: in small masks and prompted pieces, and near `points` [K, 2]."""
        columns, rows = points.astype(int).T
        prompted = self.pieces[rows, columns]
        result = self._small | np.isin(self.pieces, prompted[prompted != 0])
        for x, y in zip(columns, rows, strict=True):
            result[max(0, y - _ANSWERED) : y + _ANSWERED + 1, max(0, x - _ANSWERED) : x + _ANSWERED + 1] = True
        return np.asarray(result)


def open_points(pieces: NDArray[np.integer[Any]], answered: NDArray[np.bool_], count: int) -> NDArray[np.float64]:
    """Chooses at most `count` points [K, 2], x and y, farthest from edges first.

    Edges are those of pieces [h, w], of `answered` pixels and of the image. Points of a connected piece are kept apart.
    """
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
