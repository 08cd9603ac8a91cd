"""Boundary IoU: agreement of outlines, which the plain IoU of large areas hides."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.evaluation.metrics import Skipped, ViewMetric, ViewPrediction
from benchmarks.evaluation.segmentation import NO_TRUTH, MaskCounts, check_maps, overlap, total

DIAGONAL_SHARE = 0.02
"""Width of the boundary region as a share of the image's diagonal: that of Cheng et al. 2021 for COCO and LVIS, and
of Gaussian Grouping's mBIoU."""


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
    return overlap(boundary_region(predicted, width), boundary_region(truth, width), valid)


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


def view_boundary_counts(view: ViewPrediction) -> MaskCounts | Skipped:
    """Counts of the masks by argmax; without a label map, of the annotated texts' masks."""
    labels, truth = len(view.dictionary), view.truth
    if truth.labels is not None:
        return boundary_counts(view.label_map, truth.labels, labels, truth.valid)
    if not view.queries:
        return Skipped(NO_TRUTH)
    counts = MaskCounts.zeros(labels).counts
    for query in view.queries:
        counts[query.label_id] += mask_boundary_counts(query.leading_mask, query.truth.mask, truth.valid)
    return MaskCounts(counts)


BOUNDARY_IOU = ViewMetric(
    name="boundary_iou",
    description="boundary IoU (Cheng et al. 2021, equation 1) of the masks by argmax; pixels pooled over the test "
    "views, mean over the labels that the truth shows",
    measure=view_boundary_counts,
    combine=lambda counts: total(counts).macro_iou(),
)
