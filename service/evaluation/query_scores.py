"""Scores of single questions: one text in one view, as LERF and 3D-OVS count them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fastsplat.service.evaluation.localization import peak_in_box, peak_in_mask
from fastsplat.service.evaluation.segmentation import overlap
from fastsplat.service.evaluation.types import QueryPrediction, Skipped, ViewMetric, ViewPrediction, mean


@dataclass(frozen=True)
class QueryScore:
    """One text in one view.

    Attributes:
        view: the image's name.
        text: the question.
        label_id: of the data set's dictionary.
        verdict: the answer's.
        answered: the label that leads the answer, "" if the scene has none.
        iou: of the pixels whose most probable label is the leading one; the text has to be one of the scene's labels.
        iou_threshold: of the mask that the service answers with: empty when it says that nothing relevant is here.
        peak_in_box, peak_in_mask: of the relevancy map, see `service.evaluation.localization`.
    """

    view: str
    text: str
    label_id: int
    outcome: str
    answered: str
    iou: float
    iou_threshold: float
    peak_in_box: bool
    peak_in_mask: bool


def query_scores(view: ViewPrediction) -> tuple[QueryScore, ...] | Skipped:
    """The scores of all texts that the truth shows in the view."""
    if not view.queries:
        return Skipped("the truth shows no label in the view")
    return tuple(_score(view, query) for query in view.queries)


def _score(view: ViewPrediction, query: QueryPrediction) -> QueryScore:
    truth, valid = query.truth, view.truth.valid
    return QueryScore(
        view=view.truth.name,
        text=truth.text,
        label_id=query.label_id,
        outcome=query.answer.outcome,
        answered=query.answer.matches[0].label if query.answer.matches else "",
        iou=_iou(overlap(query.leading_mask, truth.mask, valid)),
        iou_threshold=_iou(overlap(query.answer_mask, truth.mask, valid)),
        peak_in_box=peak_in_box(query.relevancy, truth.boxes),
        peak_in_mask=peak_in_mask(query.relevancy, truth.mask),
    )


def _iou(counts: tuple[int, int, int]) -> float:
    both, truth, predicted = counts
    return both / max(1, truth + predicted - both)


def _mean_of(name: str, scores: Sequence[tuple[QueryScore, ...]]) -> float:
    return mean([float(getattr(score, name)) for view in scores for score in view])


LOCALIZATION = ViewMetric(
    name="localization",
    unit="",
    higher_is_better=True,
    description="share of pairs of view and text whose relevancy map peaks in one of the text's boxes (LERF; without "
    "its mean filter, and of a label map with one box around all pixels of the label)",
    measure=query_scores,
    combine=lambda scores: _mean_of("peak_in_box", scores),
    headline=True,
)
LOCALIZATION_PEAK_IN_MASK = ViewMetric(
    name="localization_peak_in_mask",
    unit="",
    higher_is_better=True,
    description="as localization, with the peak in the text's mask",
    measure=query_scores,
    combine=lambda scores: _mean_of("peak_in_mask", scores),
    headline=True,
)
MIOU_VIEWS = ViewMetric(
    name="miou_views",
    unit="",
    higher_is_better=True,
    description="mean IoU over pairs of view and text, as tables of LERF-OVS and 3D-OVS print it, of the masks by "
    "argmax over the scene's labels; the texts are label names, so language hardly enters",
    measure=query_scores,
    combine=lambda scores: _mean_of("iou", scores),
)
MIOU_THRESHOLD_VIEWS = ViewMetric(
    name="miou_threshold_views",
    unit="",
    higher_is_better=True,
    description="as miou_views, of the masks that the service answers with",
    measure=query_scores,
    combine=lambda scores: _mean_of("iou_threshold", scores),
)
