"""A trained scene, measured on the test split of a data set."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from benchmarks.evaluation.datasets.dataset import Dataset
from benchmarks.evaluation.metrics import EvaluatedScene, Report, Skipped, ViewMetric
from benchmarks.evaluation.predictions import ask_all, predict_view, texts_of, truth_ids
from benchmarks.evaluation.registry import METRICS
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat_contract.errors import InvalidInputError

_SAME = 1e-4


def evaluate_scene(index: SceneIndex, dataset: Dataset) -> Report:
    """Every metric of `registry.METRICS` on the test views; the order of the views changes nothing.

    A label of the data set that the scene does not have is a missing prediction and counts as zero. A label of the
    scene that the data set does not have counts as no label.

    Args:
        index: the scene, with the text encoder and threshold that it is to be asked with.
        dataset: see `datasets.reading.read_dataset`.

    Raises:
        InvalidInputError: the scene was trained on a test view, or lies in another world frame than the data set.
    """
    check_unseen(index.scene, dataset)
    views = sorted(dataset.test, key=lambda view: view.name)
    texts = sorted({text for view in views for text in texts_of(view, dataset.dictionary)})
    answers = dict(zip(texts, ask_all(index, texts), strict=True))
    to_truth = truth_ids(index.scene.dictionary, dataset.dictionary)
    measured: dict[Any, list[Any]] = {metric.measure: [] for metric in METRICS if isinstance(metric, ViewMetric)}
    for view in views:
        prediction = predict_view(index, view, dataset.dictionary, to_truth, answers)
        for measure, results in measured.items():
            results.append(measure(prediction))
    figures: dict[str, float | None] = {}
    reasons: dict[str, str] = {}
    details: dict[str, Any] = {}
    for metric in METRICS:
        if isinstance(metric, ViewMetric):
            result = _combined(metric, measured[metric.measure])
        else:
            of_scene = metric.measure(EvaluatedScene(index, dataset))
            details |= {} if isinstance(of_scene, Skipped) else of_scene.details
            result = of_scene if isinstance(of_scene, Skipped) else of_scene.value
        figures[metric.name] = None if isinstance(result, Skipped) else result
        if isinstance(result, Skipped):
            reasons[metric.name] = result.reason
    return Report(figures, reasons, details)


def _combined(metric: ViewMetric[Any], results: Sequence[Any]) -> float | Skipped:
    counted = [result for result in results if not isinstance(result, Skipped)]
    if not counted:
        return Skipped("; ".join(dict.fromkeys(result.reason for result in results)))
    value = metric.combine(counted)
    return value if math.isfinite(value) else Skipped("the test views have nothing to measure it on")


def scene_size(scene: Scene) -> int:
    """Bytes of a scene's arrays."""
    arrays = [getattr(scene.gaussians, item.name) for item in fields(scene.gaussians)]
    arrays += [scene.head.weight, scene.head.bias, scene.label_embeddings]
    for counts in (scene.evidence, None if scene.objects is None else scene.objects.membership):
        if counts is not None:
            arrays += [counts.starts, counts.labels, counts.counts]
    return sum(int(array.nbytes) for array in arrays)


def check_unseen(scene: Scene, dataset: Dataset) -> None:
    """Raise if the scene was trained on a test view, by the image's name or by its pose.

    A scene's cameras are what it was trained on, but for those its quality names as held out.

    Raises:
        InvalidInputError: the scene saw a test view, or an image of the same name has another pose in it.
    """
    held_out = set(scene.facts.held_out_views or ())
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
                hint="Train it on the data set's training split alone.",
            )
        if view.posed is not None and view.name in stated and np.abs(stated[view.name] - pose).max() > _SAME:
            raise InvalidInputError(
                f"{view.name} has another pose in the scene than in {dataset.folder.name}",
                field="scene",
                hint="Give the scene the data set's own poses; a reconstruction of its own has another world frame.",
            )
