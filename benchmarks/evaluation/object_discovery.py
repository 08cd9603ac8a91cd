"""Objects without a vocabulary, compared with the true objects of the test views: recall, precision, and what one
naming click on each is worth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.evaluation.datasets.dataset import Dataset, TrueView
from benchmarks.evaluation.metrics import EvaluatedScene, SceneFigure, SceneMetric, Skipped
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat.service.splatting.labels.blending import object_map

F64 = NDArray[np.float64]

MIN_PIXELS = 64
"""True objects that all test views together show less of, and discovered ones, do not count."""
_UNLABELED = 0.5
"""A discovered object of which more lies where the truth names nothing is neither right nor wrong."""


@dataclass(frozen=True)
class ObjectCounts:
    """Pixels of all test views by true object and by discovered object.

    Attributes:
        pixels: int64 [N + 1, T + 1]; row 0 is where the truth names nothing, column 0 where no object was discovered.
    """

    pixels: NDArray[np.int64]

    @property
    def present(self) -> NDArray[np.bool_]:
        """bool [N]: true objects that count."""
        return np.asarray(self.pixels[1:].sum(axis=1) >= MIN_PIXELS)

    @property
    def judged(self) -> NDArray[np.bool_]:
        """bool [T]: discovered objects that are right or wrong: seen, and mostly where the truth names something."""
        seen = self.pixels[:, 1:].sum(axis=0)
        return np.asarray((seen >= MIN_PIXELS) & (self.pixels[0, 1:] <= _UNLABELED * seen))

    def iou(self) -> F64:
        """float64 [N, T]: intersection over union, pixels of all views pooled."""
        common = self.pixels[1:, 1:]
        union = self.pixels[1:].sum(axis=1, keepdims=True) + self.pixels[:, 1:].sum(axis=0) - common
        return np.asarray(common / np.maximum(union, 1))


def recall_at(counts: ObjectCounts, threshold: float) -> float:
    """Share of the true objects that exist as exactly one object: matched one to one with an IoU of at least
    `threshold`, which from 0.5 on leaves no choice but ties."""
    iou = counts.iou()[counts.present]
    matched = {int(row.argmax()) for row in iou if len(row) and row.max() >= threshold}
    return len(matched) / max(1, len(iou))


def precision_at(counts: ObjectCounts, threshold: float) -> float:
    """Share of the judged objects that are a true object, NaN without any."""
    if not counts.judged.any():
        return float("nan")
    return float((counts.iou()[:, counts.judged].max(axis=0, initial=0) >= threshold).mean())


def simulate_clicks(dataset: Dataset, maps: Mapping[str, NDArray[np.int32]]) -> float:
    """Mean IoU over the true objects after a person named them by clicks.

    The person clicks each true object once, in the test view where it is largest and there where it is widest, and
    gives the object under the click its name; an object that was clicked before gets the new name. The largest true
    objects come first.

    Args:
        dataset: the truth.
        maps: the object of each pixel of each test view, by the view's name.
    """
    truths = [(view.name, true_objects(view)) for view in dataset.test if view.name in maps]
    areas = {name: np.bincount(truth.ravel()) for name, truth in truths}
    count = max((len(area) for area in areas.values()), default=1)
    total = np.sum([np.bincount(truth.ravel(), minlength=count) for _, truth in truths], axis=0)
    order = [number for number in np.argsort(-total[1:], kind="stable") + 1 if total[number] >= MIN_PIXELS]
    named: dict[int, int] = {}
    by_name = dict(truths)
    for number in order:
        where = max(areas, key=lambda name: areas[name][number] if number < len(areas[name]) else 0)
        row, column = widest(by_name[where] == number)
        obj = int(maps[where][row, column])
        if obj:
            named[obj] = int(number)
    return _mean_iou(named, order, by_name, maps) if order else float("nan")


def count_objects(scene: Scene, dataset: Dataset, maps: Mapping[str, NDArray[np.int32]]) -> ObjectCounts:
    """The counts of all test views of a scene with objects; other arguments as for `simulate_clicks`."""
    assert scene.objects is not None
    table = scene.objects.table
    column = np.zeros(max((obj.id for obj in table), default=0) + 1, np.int64)
    column[[obj.id for obj in table]] = np.arange(1, len(table) + 1)
    truths = {view.name: true_objects(view) for view in dataset.test if view.name in maps}
    rows = max((int(truth.max(initial=0)) for truth in truths.values()), default=0) + 1
    pixels = np.zeros(rows * (len(table) + 1), np.int64)
    for view in dataset.test:
        if view.name in maps:
            keys = truths[view.name] * (len(table) + 1) + column[maps[view.name]]
            counted = keys if view.valid is None else keys[view.valid]
            pixels += np.bincount(counted.ravel(), minlength=len(pixels))
    return ObjectCounts(pixels.reshape(rows, -1))


def true_objects(view: TrueView) -> NDArray[np.int64]:
    """int64 [H, W]: the true object of each pixel: the data set's own instances, or its labels, each of which then
    stands for one object."""
    truth = view.instances if view.instances is not None else view.labels
    assert truth is not None
    return truth.astype(np.int64)


def object_maps(scene: EvaluatedScene) -> dict[str, NDArray[np.int32]]:
    """The object of each pixel of every test view with a pose and a truth of objects."""
    index = scene.index
    return {
        view.name: object_map(index.scene, view.posed, backend=index.settings.backend)
        for view in scene.dataset.test
        if view.posed is not None and (view.instances is not None or view.labels is not None)
    }


def _recall_50(scene: EvaluatedScene, counts: ObjectCounts) -> SceneFigure:
    details = {
        "objects_discovered": len(counts.judged),
        "objects_judged": int(counts.judged.sum()),
        "objects_true": int(counts.present.sum()),
        "objects_mean_iou": float(counts.iou()[counts.present].max(axis=1, initial=0).mean()),
    }
    return SceneFigure(recall_at(counts, 0.5), details=details)


def _precision(scene: EvaluatedScene, counts: ObjectCounts) -> SceneFigure | Skipped:
    if not counts.judged.any():
        return Skipped("no object was discovered where the truth names something")
    return SceneFigure(precision_at(counts, 0.5))


def _metric(
    name: str, description: str, figure: Callable[[EvaluatedScene, ObjectCounts], SceneFigure | Skipped]
) -> SceneMetric:
    """A figure of the counts of all test views, skipped where there are none."""

    def measure(scene: EvaluatedScene) -> SceneFigure | Skipped:
        if scene.index.scene.objects is None:
            return Skipped("nobody looked for objects in this scene")
        maps = object_maps(scene)
        counts = count_objects(scene.index.scene, scene.dataset, maps) if maps else None
        if counts is None or not counts.present.any():
            return Skipped("the test views do not say which objects they show")
        return figure(scene, counts)

    return SceneMetric(name, description, measure)


def widest(mask: NDArray[np.bool_]) -> tuple[int, int]:
    """Row and column where a mask [H, W] is widest: where a person clicks."""
    depth = cv2.distanceTransform(np.pad(mask.astype(np.uint8), 1), cv2.DIST_L2, 3)[1:-1, 1:-1]
    row, column = np.unravel_index(int(depth.argmax()), depth.shape)
    return int(row), int(column)


def _mean_iou(
    named: Mapping[int, int],
    order: list[Any],
    truths: Mapping[str, NDArray[np.int64]],
    maps: Mapping[str, NDArray[np.int32]],
) -> float:
    by_object = np.zeros(max([*named, *(int(m.max(initial=0)) for m in maps.values())]) + 1, np.int64)
    by_object[list(named)] = list(named.values())
    common, union = np.zeros(len(order)), np.zeros(len(order))
    for name, truth in truths.items():
        number_map = by_object[maps[name]]
        for place, number in enumerate(order):
            common[place] += ((truth == number) & (number_map == number)).sum()
            union[place] += ((truth == number) | (number_map == number)).sum()
    return float((common / np.maximum(union, 1)).mean())


OBJECTS_RECALL_50 = _metric(
    "objects_recall_50",
    "share of true objects that exist as exactly one discovered object, by an IoU of at least 0.5 over the pixels of "
    "all test views; a measure of this project's own",
    _recall_50,
)
OBJECTS_RECALL_75 = _metric(
    "objects_recall_75",
    "as objects_recall_50, by an IoU of at least 0.75",
    lambda scene, counts: SceneFigure(recall_at(counts, 0.75)),
)
OBJECTS_PRECISION = _metric(
    "objects_precision",
    "share of discovered objects that are a true object, by an IoU of at least 0.5; objects that lie mostly where the "
    "truth names nothing do not count",
    _precision,
)
CLICKS_MIOU = _metric(
    "clicks_miou",
    "mean IoU over true objects after each was named by one click where it is largest; a measure of this project's own",
    lambda scene, counts: SceneFigure(simulate_clicks(scene.dataset, object_maps(scene))),
)
