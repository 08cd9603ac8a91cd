"""A trained scene, measured on the test split of a data set."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.progress import Progress, ProgressEvent, silent
from fastsplat.service.evaluation.bootstrap import bootstrap_interval
from fastsplat.service.evaluation.datasets.types import Dataset, TrueView
from fastsplat.service.evaluation.evaluation_report import Figure, Report, RunCost
from fastsplat.service.evaluation.negative_queries import ask_all
from fastsplat.service.evaluation.predictions import predict_view, texts_of, truth_ids
from fastsplat.service.evaluation.query_scores import query_scores
from fastsplat.service.evaluation.registry import METRICS
from fastsplat.service.evaluation.types import (
    EvaluatedScene,
    SceneFigure,
    SceneMetric,
    Skipped,
    ViewMetric,
    ViewPrediction,
)
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.types import Scene
from fastsplat_contract.errors import InvalidInputError

_SAME = 1e-4
_Measure = Callable[[ViewPrediction], Any]
_Measured = Mapping[_Measure, Sequence[Any]]
"""By measuring function: a contribution or `Skipped` for each view, in their order."""

_NO_COST = RunCost()


def evaluate_scene(
    index: SceneIndex,
    dataset: Dataset,
    *,
    cost: RunCost = _NO_COST,
    samples: int = 1000,
    progress: Progress = silent,
    on_view: Callable[[ViewPrediction], None] = lambda view: None,
) -> Report:
    """Every metric of `registry.METRICS` on the test views; the order of the views changes nothing.

    A label of the data set that the scene does not have is a missing prediction and counts as zero. A label of the
    scene that the data set does not have counts as no label.

    Args:
        index: the scene, with the text encoder and threshold that it is to be asked with.
        dataset: see `service.evaluation.datasets.read_dataset`.
        cost: of making the scene; the stage "scoring" is added to its seconds.
        samples: bootstrap resamples; 0 leaves the intervals out.
        progress: hears of every view, stage "scoring".
        on_view: is given every view's prediction, e.g. to draw it.

    Raises:
        InvalidInputError: the scene was trained on a test view, or lies in another world frame than the data set.
    """
    began = time.perf_counter()
    check_unseen(index.scene, dataset)
    views = sorted(dataset.test, key=lambda view: view.name)
    texts = tuple(sorted({text for view in views for text in texts_of(view, dataset.dictionary)}))
    evaluated = EvaluatedScene(index, dataset, truth_ids(index.scene.dictionary, dataset.dictionary), texts)
    measured = _measure_views(evaluated, views, progress, on_view)
    progress(ProgressEvent("scoring", 1.0, "intervals"))
    names, labels = [view.name for view in views], [entry.label for entry in dataset.dictionary.entries]
    figures: dict[str, Figure] = {}
    details: dict[str, Any] = {}
    for metric in METRICS:
        if isinstance(metric, ViewMetric):
            figures[metric.name] = _view_figure(metric, names, measured[metric.measure], labels, samples)
        else:
            result = metric.measure(evaluated)
            figures[metric.name] = _scene_figure(metric, result, labels)
            details |= {} if isinstance(result, Skipped) else result.details
    return Report(
        figures=figures,
        gaussians=len(index.scene.gaussians),
        bytes=cost.scene_bytes or scene_size(index.scene),
        seconds={**cost.seconds, "scoring": time.perf_counter() - began},
        peak_mb=cost.peak_mb,
        queries=tuple(score for scores in _contributions(measured[query_scores]) for score in scores),
        views=tuple(_view_row(name, row, measured) for row, name in enumerate(names)),
        dataset=_about_dataset(dataset),
        conditions=_conditions(index),
        details=details,
    )


def scene_size(scene: Scene) -> int:
    """Bytes of a scene's arrays."""
    arrays = [getattr(scene.gaussians, item.name) for item in fields(scene.gaussians)]
    arrays += [scene.head.weight, scene.head.bias, scene.label_embeddings]
    for counts in (scene.evidence, None if scene.things is None else scene.things.membership):
        if counts is not None:
            arrays += [counts.starts, counts.labels, counts.counts]
    return sum(int(array.nbytes) for array in arrays)


def _measure_views(
    evaluated: EvaluatedScene,
    views: Sequence[TrueView],
    progress: Progress,
    on_view: Callable[[ViewPrediction], None],
) -> _Measured:
    """Every measurement of every view; each view is predicted once, and only its measurements are kept."""
    index, dictionary = evaluated.index, evaluated.dataset.dictionary
    answers = dict(zip(evaluated.texts, ask_all(index, evaluated.texts), strict=True))
    measured: dict[_Measure, list[Any]] = {query_scores: []}
    measured |= {metric.measure: [] for metric in METRICS if isinstance(metric, ViewMetric)}
    for number, view in enumerate(views):
        progress(ProgressEvent("scoring", number / len(views), f"view {number + 1}/{len(views)}"))
        prediction = predict_view(index, view, dictionary, evaluated.to_truth, answers)
        on_view(prediction)
        for measure, results in measured.items():
            results.append(measure(prediction))
    return measured


def _contributions(results: Sequence[Any]) -> list[Any]:
    return [result for result in results if not isinstance(result, Skipped)]


def _view_figure(
    metric: ViewMetric[Any], names: Sequence[str], results: Sequence[Any], labels: Sequence[str], samples: int
) -> Figure:
    skipped = {name: result.reason for name, result in zip(names, results, strict=True) if isinstance(result, Skipped)}
    counted = _contributions(results)
    if not counted:
        return Figure(metric, None, "; ".join(dict.fromkeys(skipped.values())), skipped=skipped)
    per_label = {} if metric.per_label is None else _by_label(metric.per_label(counted), labels)
    value = metric.combine(counted)
    if not math.isfinite(value):
        return Figure(metric, None, metric.undefined, per_label=per_label, skipped=skipped)
    interval = bootstrap_interval(counted, metric.combine, samples=samples) if samples else None
    return Figure(metric, value, "", interval, per_label, skipped)


def _scene_figure(metric: SceneMetric, result: SceneFigure | Skipped, labels: Sequence[str]) -> Figure:
    if isinstance(result, Skipped):
        return Figure(metric, None, result.reason)
    per_label = {} if result.per_label is None else _by_label(result.per_label, labels)
    return Figure(metric, result.value, per_label=per_label)


def _by_label(values: NDArray[np.float64], labels: Sequence[str]) -> dict[str, float]:
    return dict(zip(labels, values[1:].tolist(), strict=True))


def _view_row(name: str, row: int, measured: _Measured) -> dict[str, Any]:
    figures: dict[str, Any] = {"name": name}
    for metric in METRICS:
        if isinstance(metric, ViewMetric) and metric.headline:
            result = measured[metric.measure][row]
            figures[metric.name] = None if isinstance(result, Skipped) else metric.combine([result])
    return figures


def _about_dataset(dataset: Dataset) -> dict[str, Any]:
    return {
        "name": dataset.folder.name,
        "kind": dataset.kind,
        "split": dataset.split,
        "train_views": len(dataset.train),
        "test_views": len(dataset.test),
        "labels": len(dataset.dictionary),
        "notes": list(dataset.notes),
    }


def _conditions(index: SceneIndex) -> dict[str, Any]:
    return {
        "label_mode": index.scene.label_mode,
        "alpha_min": index.settings.alpha_min,
        "score": index.settings.score,
        "text_encoder": index.scene.text_encoder[0],
        "encoder_calibrated": index.calibrated,
    }


def check_unseen(scene: Scene, dataset: Dataset) -> None:
    """Raise if the scene was trained on a test view, by the image's name or by its pose.

    A scene's cameras are what it was trained on, but for those its quality names as held out.

    Raises:
        InvalidInputError: the scene saw a test view, or an image of the same name has another pose in it.
    """
    held_out = set(scene.quality.get("held_out_views", ()))
    trained = [posed for posed in scene.cameras if posed.name not in held_out]
    names = {posed.name for posed in trained}
    stated = {posed.name: posed.world_from_camera for posed in scene.cameras}
    for view in dataset.test:
        leaked = view.name in names
        if view.posed is not None:
            pose = view.posed.world_from_camera
            leaked = leaked or any(np.abs(posed.world_from_camera - pose).max() < _SAME for posed in trained)
        if leaked:
            raise InvalidInputError(
                f"the scene was trained on the test view {view.name}",
                field="scene",
                hint="Train it on the data set's training split alone: fastsplat evaluate does, without --scene.",
            )
        if view.posed is not None and view.name in stated and np.abs(stated[view.name] - pose).max() > _SAME:
            raise InvalidInputError(
                f"{view.name} has another pose in the scene than in {dataset.folder.name}",
                field="scene",
                hint="Give the scene the data set's own poses; a reconstruction of its own has another world frame.",
            )
