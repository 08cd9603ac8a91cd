"""What LangSplat's evaluation makes of a relevancy map: a point, and a mask.

Definitions are those of the code published with LangSplat (Qin et al. 2024), `eval/evaluate_iou_loc.py` and
`eval/utils.py` of github.com/minghanqin/LangSplat at commit 26ed214, of one map a text: its choice among three levels
of features has no counterpart here.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.evaluation.localization import Box
from fastsplat_contract.errors import InvalidInputError

MEAN_FILTER_PX = 30
"""Side of LangSplat's mean filter; LERF (Kerr et al. 2023) reports none."""

MASK_THRESHOLD = 0.4
"""`--mask_thresh` by default."""

_MAJORITY_RADIUS = 3
_TINY = 1e-9


def mean_filtered(relevancy: NDArray[np.floating], side: int = MEAN_FILTER_PX) -> NDArray[np.float32]:
    """float32 [H, W]: the mean of `side` × `side` pixels around each, the image mirrored at its border.

    Around a pixel (y, x) these are y − side // 2 .. y − side // 2 + side − 1, and x alike, as `cv2.filter2D` has it.

    Args:
        relevancy: [H, W]; NaN counts as 0.
        side: of the square, pixels.

    Raises:
        InvalidInputError: no two-dimensional map, an empty one, or a side below 1.
    """
    values = _checked(relevancy)
    if side < 1:
        raise InvalidInputError(f"a mean filter of {side} pixels", field="side", limit="1 or more")
    blurred = cv2.blur(values, (side, side), anchor=(side // 2, side // 2), borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(blurred, np.float32)


def localized(relevancy: NDArray[np.floating], boxes: Sequence[Box], *, mean_filter_px: int = MEAN_FILTER_PX) -> bool:
    """Whether a highest pixel of the filtered map lies in one of the boxes, their edges included.

    Pixels count by their column and row, without the half that lies between a pixel's corner and its center; of
    several that are equally high one is enough. A map that is nowhere above 0 points nowhere.

    Args:
        relevancy: [H, W]; NaN counts as 0.
        boxes: x1, y1, x2, y2 in any order of the corners, pixels of the map.
        mean_filter_px: side of the mean filter.

    Raises:
        InvalidInputError: as `mean_filtered`.
    """
    filtered = mean_filtered(relevancy, mean_filter_px)
    if filtered.max() <= 0:
        return False
    rows, columns = np.nonzero(filtered == filtered.max())
    for x1, y1, x2, y2 in boxes:
        across = (columns >= min(x1, x2)) & (columns <= max(x1, x2))
        if bool((across & (rows >= min(y1, y2)) & (rows <= max(y1, y2))).any()):
            return True
    return False


def thresholded_mask(
    relevancy: NDArray[np.floating], threshold: float = MASK_THRESHOLD, *, mean_filter_px: int = MEAN_FILTER_PX
) -> NDArray[np.bool_]:
    """bool [H, W]: the mask that a relevancy map stands for.

    The map's mean with its filtered self is stretched to 0..1, of which the upper half is stretched to 0..1 again
    (the lower half becomes 0); what lies above `threshold` then is the mask, after `majority_smoothed`. So 0.4 of the
    default is 0.7 of the way from the map's lowest to its highest value.

    Args:
        relevancy: [H, W]; NaN counts as 0.
        threshold: above 0 and below 1.
        mean_filter_px: side of the mean filter.

    Raises:
        InvalidInputError: as `mean_filtered`, or a threshold outside 0..1.
    """
    if not 0 < threshold < 1:
        raise InvalidInputError(f"a threshold of {threshold}", field="threshold", limit="above 0 and below 1")
    blended = 0.5 * (mean_filtered(relevancy, mean_filter_px) + _checked(relevancy))
    stretched = blended - blended.min()
    stretched /= stretched.max() + _TINY
    return majority_smoothed(np.clip(2 * stretched - 1, 0, 1) > threshold)


def majority_smoothed(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """bool [H, W]: of each pixel the majority among the 7 × 7 pixels around it that lie in the image; ties say no.

    As in the published code, the last row and the last column of the image vote for nobody.
    """
    height, width = mask.shape
    sums = np.zeros((height + 1, width + 1), np.int64)
    sums[1:, 1:] = mask.cumsum(axis=0).cumsum(axis=1)
    first_row, last_row = _window(height)
    first_column, last_column = _window(width)
    votes = (
        sums[np.ix_(last_row, last_column)]
        - sums[np.ix_(first_row, last_column)]
        - sums[np.ix_(last_row, first_column)]
        + sums[np.ix_(first_row, first_column)]
    )
    area = np.outer(last_row - first_row, last_column - first_column)
    return np.asarray(2 * votes > area)


def _window(length: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First pixel of each pixel's window, and the first after it."""
    places = np.arange(length)
    first = np.maximum(places - _MAJORITY_RADIUS, 0)
    return first, np.maximum(np.minimum(places + _MAJORITY_RADIUS + 1, length - 1), first)


def _checked(relevancy: NDArray[np.floating]) -> NDArray[np.float32]:
    if relevancy.ndim != 2 or not relevancy.size:
        raise InvalidInputError(f"a relevancy map of shape {relevancy.shape}", field="relevancy", hint="Pass [H, W].")
    return np.nan_to_num(np.asarray(relevancy, np.float32), nan=0.0)
