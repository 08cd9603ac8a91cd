"""Scores of single questions: one text in one view, as LERF and 3D-OVS count them."""

from __future__ import annotations

from typing import NamedTuple

from benchmarks.evaluation.localization import peak_in_box
from benchmarks.evaluation.metrics import Skipped, ViewMetric, ViewPrediction, mean
from benchmarks.evaluation.published.mask_pairs import mask_iou


class QueryScore(NamedTuple):
    """One text in one view.

    Attributes:
        iou: of the pixels whose most probable label is the leading one; the text has to be one of the scene's labels.
        peak_in_box: of the relevancy map, see `localization.peak_in_box`.
    """

    iou: float
    peak_in_box: bool


def query_scores(view: ViewPrediction) -> tuple[QueryScore, ...] | Skipped:
    """The scores of all texts that the truth shows in the view."""
    if not view.queries:
        return Skipped("the truth shows no label in the view")
    valid = True if view.truth.valid is None else view.truth.valid
    return tuple(
        QueryScore(
            mask_iou(query.leading_mask & valid, query.truth.mask & valid),
            peak_in_box(query.relevancy, query.truth.boxes),
        )
        for query in view.queries
    )


LOCALIZATION = ViewMetric(
    name="localization",
    description="share of pairs of view and text whose relevancy map peaks in one of the text's boxes (LERF; without "
    "its mean filter, and of a label map with one box around all pixels of the label)",
    measure=query_scores,
    combine=lambda views: mean([score.peak_in_box for view in views for score in view]),
)
MIOU_VIEWS = ViewMetric(
    name="miou_views",
    description="mean IoU over pairs of view and text, as tables of LERF-OVS and 3D-OVS print it, of the masks by "
    "argmax over the scene's labels; the texts are label names, so language hardly enters",
    measure=query_scores,
    combine=lambda views: mean([score.iou for view in views for score in view]),
)
