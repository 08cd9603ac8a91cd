"""Localization by a relevancy map: its peak in an object's box."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

_TIE = 1e-6

Box = tuple[float, float, float, float]
"""x1, y1, x2, y2 in pixels; the image's corners are (0, 0) and (W, H)."""


def peak(relevancy: NDArray[np.floating]) -> tuple[int, int] | None:
    """Row and column of the highest value of [H, W], or None where no value is above 0.

    Saturated maps have plateaus; of the pixels that tie (to 1e-6) it is the one deepest among them, the first in
    reading order if several are.

    NaN counts as 0.
    """
    values = np.nan_to_num(np.asarray(relevancy, np.float64), nan=0.0)
    if not values.size or values.max() <= 0:
        return None
    ties = (values >= values.max() - _TIE).astype(np.uint8)
    padded = cv2.copyMakeBorder(ties, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    depth = cv2.distanceTransform(padded, cv2.DIST_C, 3)[1:-1, 1:-1]
    row, column = np.unravel_index(int(np.argmax(depth)), depth.shape)
    return int(row), int(column)


def peak_in_box(relevancy: NDArray[np.floating], boxes: Sequence[Box]) -> bool:
    """Whether the centre of the peak's pixel lies in one of the boxes (LERF's localization; False without a peak)."""
    highest = peak(relevancy)
    if highest is None:
        return False
    y, x = highest[0] + 0.5, highest[1] + 0.5
    return any(x1 <= x <= x2 and y1 <= y <= y2 for x1, y1, x2, y2 in boxes)


def box_of(mask: NDArray[np.bool_]) -> Box | None:
    """The tightest box around a mask [H, W], or None around nothing."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return None
    return float(columns[0]), float(rows[0]), float(columns[-1] + 1), float(rows[-1] + 1)
