"""The result of an evaluation, and its JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from fastsplat.service.evaluation.bootstrap import Interval
from fastsplat.service.evaluation.query_scores import QueryScore
from fastsplat.service.evaluation.types import SceneMetric, ViewMetric


@dataclass(frozen=True)
class Figure:
    """The value of one metric.

    Attributes:
        metric: its definition.
        value: None where it was not measured.
        reason: why it was not, "" where it was.
        interval: 95 % bootstrap interval over the test views; None for a metric of the scene, and where there is none.
        per_label: by label name; NaN for one in neither truth nor prediction. Empty where labels have no figure.
        skipped: why views did not count, by their names.
    """

    metric: ViewMetric[Any] | SceneMetric
    value: float | None
    reason: str = ""
    interval: Interval | None = None
    per_label: Mapping[str, float] = field(default_factory=dict)
    skipped: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class RunCost:
    """What a scene cost to make.

    Attributes:
        seconds: by stage.
        scene_bytes: on disk; None: those of the arrays.
        peak_mb: of the process that trained, 10^6 bytes; None: nothing was trained here.
    """

    seconds: Mapping[str, float] = field(default_factory=dict)
    scene_bytes: int | None = None
    peak_mb: float | None = None


@dataclass(frozen=True)
class Report:
    """Figures of one scene on the test views of one data set.

    Attributes:
        figures: by metric name, one for every metric, in the order of `registry.METRICS`.
        gaussians: number of them.
        bytes: of the scene.
        seconds: by stage, "scoring" included.
        peak_mb: see `RunCost`.
        queries: every text in every view.
        views: the headline figures of each view by name, None where the view was skipped.
        dataset: name, kind, splits, number of labels, notes.
        conditions: how the scene was asked: text encoder, score, opacity bound, label mode.
        details: further facts that metrics report, ready for JSON but for NaN.
    """

    figures: Mapping[str, Figure]
    gaussians: int
    bytes: int
    seconds: Mapping[str, float]
    peak_mb: float | None
    queries: tuple[QueryScore, ...] = ()
    views: tuple[Mapping[str, Any], ...] = ()
    dataset: Mapping[str, Any] = field(default_factory=dict)
    conditions: Mapping[str, Any] = field(default_factory=dict)
    details: Mapping[str, Any] = field(default_factory=dict)

    def value(self, name: str) -> float | None:
        """The value of a metric, None where it was not measured."""
        return self.figures[name].value

    def to_json(self) -> dict[str, Any]:
        """Ready for `json.dumps(allow_nan=False)`: each metric's value under its name, null where it was not measured,
        with the reason under `reasons`; its definition is under `metrics`, label figures under `<name>_per_class`."""
        figures = self.figures.values()
        written = {
            **{figure.metric.name: figure.value for figure in figures},
            **{f"{figure.metric.name}_per_class": figure.per_label for figure in figures if _has_labels(figure)},
            "metrics": {figure.metric.name: _definition(figure.metric) for figure in figures},
            "intervals": {figure.metric.name: figure.interval for figure in figures if figure.interval is not None},
            "reasons": {figure.metric.name: figure.reason for figure in figures if figure.value is None},
            "skipped": {figure.metric.name: figure.skipped for figure in figures if figure.skipped},
            "gaussians": self.gaussians,
            "bytes": self.bytes,
            "bytes_per_gaussian": self.bytes / max(1, self.gaussians),
            "seconds": self.seconds,
            "peak_mb": self.peak_mb,
            "dataset": self.dataset,
            "conditions": self.conditions,
            "views": self.views,
            "queries": [asdict(score) for score in self.queries],
            **self.details,
        }
        if self.peak_mb is None:
            written["reasons"]["peak_mb"] = "nothing was trained here"
        return {name: _plain(value) for name, value in written.items()}


def _has_labels(figure: Figure) -> bool:
    metric = figure.metric
    return bool(figure.per_label) or (isinstance(metric, ViewMetric) and metric.per_label is not None)


def _definition(metric: ViewMetric[Any] | SceneMetric) -> dict[str, Any]:
    return {
        "unit": metric.unit,
        "higher_is_better": metric.higher_is_better,
        "description": metric.description,
        "parameters": dict(metric.parameters),
    }


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return round(value, 6) if math.isfinite(value) else None
    return value
