"""Published protocols as metrics, each under the name of the paper whose code defines it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from benchmarks.evaluation.metrics import QueryPrediction, Skipped, ViewMetric, ViewPrediction, mean
from benchmarks.evaluation.published.mask_pairs import (
    PairScore,
    lerf_mask,
    mask_iou,
    pair_score,
    share_above,
)
from benchmarks.evaluation.published.relevancy_maps import localized, thresholded_mask


@dataclass(frozen=True)
class PublishedScores:
    """One text in one view.

    Attributes:
        localized: whether the filtered relevancy map peaks in a box.
        relevancy_iou: of the mask by LangSplat's default threshold.
        silhouette_iou: of the selected Gaussians, drawn alone.
        answer: of the mask that the service answers with; no prediction where the answer is that nothing is there.
    """

    localized: bool
    relevancy_iou: float
    silhouette_iou: float
    answer: PairScore


def published_scores(view: ViewPrediction) -> tuple[PublishedScores, ...] | Skipped:
    """The scores of all texts that the truth shows in the view's pixels that count."""
    valid = True if view.truth.valid is None else view.truth.valid
    queries = [query for query in view.queries if (query.truth.mask & valid).any()]
    if not queries:
        return Skipped("the truth shows no label in the view")
    return tuple(_scores(view, query, valid) for query in queries)


def _scores(view: ViewPrediction, query: QueryPrediction, valid: NDArray[np.bool_] | bool) -> PublishedScores:
    truth, absent = query.truth.mask & valid, query.answer.is_absent
    relevancy = query.relevancy
    return PublishedScores(
        localized=localized(relevancy, query.truth.boxes),
        relevancy_iou=mask_iou(thresholded_mask(relevancy) & valid, truth),
        silhouette_iou=mask_iou(query.silhouette & valid, truth),
        answer=pair_score(query.truth.text, truth, None if absent else query.answer_mask & valid),
    )


_Views = Sequence[tuple[PublishedScores, ...]]


def _over_pairs(figure: Callable[[PublishedScores], float]) -> Callable[[_Views], float]:
    return lambda views: mean([figure(score) for view in views for score in view])


def _answers(views: _Views) -> list[PairScore]:
    return [score.answer for view in views for score in view]


def _silhouettes(views: _Views) -> list[float]:
    return [score.silhouette_iou for view in views for score in view]


def _metric(name: str, description: str, combine: Callable[[_Views], float]) -> ViewMetric[tuple[PublishedScores, ...]]:
    return ViewMetric(name, description, published_scores, combine)


_IOU, _BOUNDARY_IOU = attrgetter("iou"), attrgetter("boundary_iou")
_LERF_MASK = "of Gaussian Grouping's LERF-Mask (Ye et al. 2024, its code), mean over texts of their means over views"

PUBLISHED = (
    _metric(
        "localization_langsplat",
        "LangSplat's localization (Qin et al. 2024, its code): share of pairs of view and text whose relevancy map "
        "peaks in any box of the text after a mean filter; of a label map with one box around all pixels of the label",
        _over_pairs(lambda score: float(score.localized)),
    ),
    _metric(
        "miou_langsplat",
        "LangSplat's mIoU (Qin et al. 2024, its code): mean over pairs of view and text of the IoU of the mask that "
        "the relevancy map is cut to, after a mean filter and a stretch to 0..1",
        _over_pairs(lambda score: score.relevancy_iou),
    ),
    _metric(
        "miou_opengaussian",
        "OpenGaussian's mIoU (Wu et al. 2024, its code): mean over pairs of view and text of the IoU of the Gaussians "
        "that answer, chosen in 3D and drawn without all others",
        lambda views: mean(_silhouettes(views)),
    ),
    _metric(
        "acc25_opengaussian",
        "share of the pairs of miou_opengaussian with an IoU above 0.25",
        lambda views: share_above(_silhouettes(views), 0.25),
    ),
    _metric(
        "acc50_opengaussian",
        "share of the pairs of miou_opengaussian with an IoU above 0.5",
        lambda views: share_above(_silhouettes(views), 0.5),
    ),
    _metric(
        "miou_lerf_mask",
        f"mIoU {_LERF_MASK}; strict: an answer that nothing is there counts as 0",
        lambda views: lerf_mask(_answers(views), _IOU, strict=True),
    ),
    _metric(
        "miou_lerf_mask_lenient",
        f"mIoU {_LERF_MASK}; lenient, as published: an answer that nothing is there is left out",
        lambda views: lerf_mask(_answers(views), _IOU, strict=False),
    ),
    _metric(
        "mbiou_lerf_mask",
        f"boundary mIoU {_LERF_MASK}; strict",
        lambda views: lerf_mask(_answers(views), _BOUNDARY_IOU, strict=True),
    ),
    _metric(
        "mbiou_lerf_mask_lenient",
        f"boundary mIoU {_LERF_MASK}; lenient, as published",
        lambda views: lerf_mask(_answers(views), _BOUNDARY_IOU, strict=False),
    ),
)
