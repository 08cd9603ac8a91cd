"""Figures over pairs of view and text, each with a true mask and a predicted one, as other papers count them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.evaluation.boundary_iou import DIAGONAL_SHARE, boundary_region, boundary_width
from benchmarks.evaluation.metrics import mean
from fastsplat_contract.errors import InvalidInputError

SILHOUETTE_ALPHA = 0.7
"""OpenGaussian's bound on the alpha of the selected Gaussians."""


@dataclass(frozen=True)
class PairScore:
    """One text in one view.

    Attributes:
        text: the question.
        predicted: whether the method made a mask at all; without one the mask is empty.
        iou: of the two masks, 0 where neither has a pixel.
        boundary_iou: of their pixels within 2 % of the image's diagonal of their outlines.
    """

    text: str
    predicted: bool
    iou: float
    boundary_iou: float


def pair_score(text: str, truth: NDArray[np.bool_], predicted: NDArray[np.bool_] | None) -> PairScore:
    """The scores of one text in one view.

    Args:
        text: the question.
        truth: bool [H, W], not empty.
        predicted: bool [H', W'], brought to the truth's size by its nearest pixels where it has another; None where
            the method made no mask.

    Raises:
        InvalidInputError: a truth that is no map or has no pixel.
    """
    if truth.ndim != 2 or not truth.any():
        raise InvalidInputError(f"{text!r} is annotated nowhere", field="truth", hint="Leave the pair out.")
    height, width = truth.shape
    mask = np.zeros_like(truth) if predicted is None else predicted
    if mask.shape != truth.shape:
        mask = cv2.resize(mask.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0
    distance = boundary_width(height, width, DIAGONAL_SHARE)
    return PairScore(
        text=text,
        predicted=predicted is not None,
        iou=mask_iou(mask, truth),
        boundary_iou=mask_iou(boundary_region(mask, distance), boundary_region(truth, distance)),
    )


def share_above(ious: Sequence[float], bound: float) -> float:
    """Share of pairs whose IoU is above a bound, OpenGaussian's accuracy (Wu et al. 2024); NaN without any.

    As `scripts/compute_lerf_iou.py` of OpenGaussian (read in github.com/zhgulden/OpenGaussian-, commit 478b2ef).
    """
    return mean([float(iou > bound) for iou in ious])


def silhouette_mask(alpha: NDArray[np.floating]) -> NDArray[np.bool_]:
    """bool [H, W]: where the selected Gaussians, drawn without all others, cover more than 0.7 of a pixel.

    Nothing hides them, so an object behind another is drawn whole (OpenGaussian's `render_lerf_by_text.py`).
    """
    return np.asarray(alpha > SILHOUETTE_ALPHA)


def lerf_mask(scores: Sequence[PairScore], figure: Callable[[PairScore], float], *, strict: bool) -> float:
    """Mean over texts of the mean of a pair's figure over views, as in `script/eval_lerf_mask.py` of
    github.com/lkeab/gaussian-grouping at commit c93f24b (Ye et al. 2024); NaN where no pair is counted.

    The published script leaves out pairs for which a method wrote no mask: the lenient figure. The strict one counts
    them as 0, so that a method cannot gain by staying silent. A text that has no pair left counts nowhere.

    Args:
        scores: of all annotated views and texts.
        figure: of a pair, its IoU or its boundary IoU.
        strict: whether missing predictions count.
    """
    by_text: dict[str, list[float]] = {}
    for score in scores:
        if strict or score.predicted:
            by_text.setdefault(score.text, []).append(figure(score))
    return mean([mean(text) for text in by_text.values()])


def mask_iou(left: NDArray[np.bool_], right: NDArray[np.bool_]) -> float:
    """Intersection over union of two masks of one shape, 0 where neither has a pixel."""
    union = int((left | right).sum())
    return int((left & right).sum()) / union if union else 0.0
