"""Boundary IoU: how well the outlines agree, which large areas hide from the plain IoU."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.evaluation.masks import MaskCounts
from fastsplat.service.evaluation.segmentation import check_maps

DIAGONAL_SHARE = 0.02
"""Width of the boundary region as a share of the image's diagonal (Cheng et al. 2021 use 2 % for COCO and LVIS)."""


def boundary_counts(
    predicted: NDArray[np.integer],
    truth: NDArray[np.integer],
    labels: int,
    valid: NDArray[np.bool_] | None = None,
    *,
    diagonal_share: float = DIAGONAL_SHARE,
) -> MaskCounts:
    """Counts of one image: |G_d ∩ P_d|, |G_d|, |P_d| of each class (Cheng et al. 2021, equation 1).

    Args:
        predicted, truth: [H, W] classes 0..labels.
        labels: N.
        valid: [H, W]; pixels that are False are not counted.
        diagonal_share: d of the regions, see `boundary_width`.

    Raises:
        InvalidInputError: shapes that differ, or a class outside 0..N.
    """
    check_maps(predicted, truth, labels)
    counts = np.zeros((labels + 1, 3), np.int64)
    for label in np.union1d(predicted, truth).tolist():
        counts[label] = mask_boundary_counts(predicted == label, truth == label, valid, diagonal_share=diagonal_share)
    return MaskCounts(counts)


def mask_boundary_counts(
    predicted: NDArray[np.bool_],
    truth: NDArray[np.bool_],
    valid: NDArray[np.bool_] | None = None,
    *,
    diagonal_share: float = DIAGONAL_SHARE,
) -> tuple[int, int, int]:
    """|G_d ∩ P_d|, |G_d|, |P_d| of one mask [H, W]; pixels that are not valid are not counted."""
    width = boundary_width(truth.shape[0], truth.shape[1], diagonal_share)
    true_region, found_region = boundary_region(truth, width), boundary_region(predicted, width)
    if valid is not None:
        true_region, found_region = true_region & valid, found_region & valid
    return int((true_region & found_region).sum()), int(true_region.sum()), int(found_region.sum())


def boundary_width(height: int, width: int, diagonal_share: float) -> int:
    """d in whole pixels, at least 1."""
    return max(1, round(diagonal_share * math.hypot(height, width)))


def boundary_region(mask: NDArray[np.bool_], width: int) -> NDArray[np.bool_]:
    """bool [H, W]: pixels of the mask at most `width` pixels (chessboard) from a pixel outside it.

    Beyond the image counts as outside, as in the paper's own code.
    """
    side = 2 * width + 1
    padded = cv2.copyMakeBorder(mask.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    kernel = np.ones((side, side), np.uint8)
    eroded = cv2.erode(padded, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(mask & (eroded[1:-1, 1:-1] == 0))
