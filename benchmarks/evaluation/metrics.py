"""Predictions for a test view, and what a metric is: a name and a function of predictions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from benchmarks.evaluation.datasets.dataset import Dataset, QueryTruth, TrueView
from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat_contract.messages.queries import Answer

C = TypeVar("C")


@dataclass(frozen=True)
class QueryPrediction:
    """One text in one view; without a pose the masks are empty and nothing is relevant.

    Attributes:
        truth: where the answer is.
        label_id: of the text in the data set's dictionary, 0 where it has none.
        answer: the scene's.
        leading_mask: bool [H, W], pixels whose most probable label is the one that leads the answer.
        answer_mask: bool [H, W], the mask that the service answers with; empty for the outcome `not_here`.
        relevancy: float32 [H, W], 0..1.
        silhouette: bool [H, W], where the Gaussians that answer, drawn without all others, cover the view; see
            `published.mask_pairs`.
    """

    truth: QueryTruth
    label_id: int
    answer: Answer
    leading_mask: NDArray[np.bool_]
    answer_mask: NDArray[np.bool_]
    relevancy: NDArray[np.float32]
    silhouette: NDArray[np.bool_]


@dataclass(frozen=True)
class ViewPrediction:
    """What a scene says of one test view, with the truth.

    Attributes:
        truth: the view.
        dictionary: the data set's, N labels.
        label_map: int32 [H, W], the most probable label of each pixel as an id of `dictionary`, 0 for none and for a
            label that the data set does not have; zeros without a pose.
        queries: one a text that the truth shows here.
        rgb: uint8 [H, W, 3], the rendered view; None without a pose.
        depth: float32 [H, W] camera z in scene units, 0 where none; None without a pose or a true depth.
    """

    truth: TrueView
    dictionary: Dictionary
    label_map: NDArray[np.int32]
    queries: tuple[QueryPrediction, ...]
    rgb: NDArray[np.uint8] | None
    depth: NDArray[np.float32] | None


@dataclass(frozen=True)
class EvaluatedScene:
    """What a metric of the whole scene may look at: the scene, with its text encoder, and the truth."""

    index: SceneIndex
    dataset: Dataset


@dataclass(frozen=True)
class Skipped:
    """A view, or a scene, in which a metric has nothing to measure.

    Attributes:
        reason: why, as a sentence for people without its full stop.
    """

    reason: str


@dataclass(frozen=True)
class ViewMetric(Generic[C]):
    """A metric of test views: something is measured in each, and the measurements are combined.

    Attributes:
        name: key of the report.
        description: what it is, with the source of its definition.
        measure: what one view contributes, or why it contributes nothing. Metrics that name the same function share
            its results.
        combine: the figure over the contributions of at least one view; NaN where they leave it undefined.
    """

    name: str
    description: str
    measure: Callable[[ViewPrediction], C | Skipped]
    combine: Callable[[Sequence[C]], float]


@dataclass(frozen=True)
class SceneFigure:
    """What a `SceneMetric` measures.

    Attributes:
        value: the figure, finite.
        details: further facts by name.
    """

    value: float
    details: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class SceneMetric:
    """A metric of a scene as a whole; attributes as in `ViewMetric`.

    Attributes:
        measure: the figure, or why there is none.
    """

    name: str
    description: str
    measure: Callable[[EvaluatedScene], SceneFigure | Skipped]


@dataclass(frozen=True)
class Report:
    """Figures of one scene on the test views of one data set.

    Attributes:
        figures: by metric name, one for every metric, None where it was not measured.
        reasons: why figures were not measured, by metric name.
        details: further facts that metrics report.
    """

    figures: Mapping[str, float | None]
    reasons: Mapping[str, str]
    details: Mapping[str, Any]


def mean(values: Sequence[float]) -> float:
    """Mean of finite values; NaN without any."""
    finite = [value for value in values if np.isfinite(value)]
    return float(np.mean(finite)) if finite else float("nan")
