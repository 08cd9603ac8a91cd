"""The metrics once more, pixel by pixel from their definitions: slow and plain, to compare the fast ones with."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray


def window(row: int, column: int, reach: int, shape: tuple[int, int]) -> list[tuple[int, int]]:
    """All pixels of the image within `reach` of one, by the chessboard distance."""
    return [
        (y, x)
        for y in range(row - reach, row + reach + 1)
        for x in range(column - reach, column + reach + 1)
        if 0 <= y < shape[0] and 0 <= x < shape[1]
    ]


def region(mask: NDArray[np.bool_], width: int) -> NDArray[np.bool_]:
    """Pixels of the mask that see a pixel outside it, or the image's end, within `width`."""
    inner = np.zeros_like(mask)
    for row, column in itertools.product(*map(range, mask.shape)):
        around = window(row, column, width, mask.shape)
        leaves = len(around) < (2 * width + 1) ** 2
        inner[row, column] = mask[row, column] and (leaves or any(not mask[place] for place in around))
    return inner


def iou(left: NDArray[np.bool_], right: NDArray[np.bool_]) -> float:
    """NaN for two empty masks."""
    union = sum(bool(a or b) for a, b in zip(left.ravel(), right.ravel(), strict=True))
    both = sum(bool(a and b) for a, b in zip(left.ravel(), right.ravel(), strict=True))
    return both / union if union else float("nan")


def mirrored(index: int, length: int) -> int:
    """The pixel that a place beyond the border stands for: b a | a' is not repeated, … 2 1 0 1 2 …"""
    while not 0 <= index < length:
        index = -index if index < 0 else 2 * (length - 1) - index
    return index


def mean_filtered(values: NDArray[np.floating], side: int) -> NDArray[np.float64]:
    """The mean of the `side` × `side` pixels that begin side // 2 before each."""
    height, width = values.shape
    result = np.zeros((height, width))
    for row, column in itertools.product(range(height), range(width)):
        square = [
            values[mirrored(row + dy - side // 2, height), mirrored(column + dx - side // 2, width)]
            for dy, dx in itertools.product(range(side), repeat=2)
        ]
        result[row, column] = sum(map(float, square)) / side**2
    return result


def majority(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Of 7 × 7 pixels around each, of which the image's last row and column are left out; ties say no."""
    height, width = mask.shape
    result = np.zeros_like(mask)
    for row, column in itertools.product(range(height), range(width)):
        square = mask[max(0, row - 3) : min(row + 4, height - 1), max(0, column - 3) : min(column + 4, width - 1)]
        result[row, column] = square.sum() > (~square).sum()
    return result
