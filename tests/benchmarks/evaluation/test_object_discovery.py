"""Which pixels and objects count where discovered objects are compared with true ones; figures: test_room_figures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.evaluation.datasets.dataset import Dataset, TrueView
from benchmarks.evaluation.object_discovery import ObjectCounts, precision_at
from fastsplat.service.scene.artefact.scene import Object, Objects, Scene
from fastsplat.service.scene.objects.label_evidence import evidence_of
from fastsplat.service.splatting.labels.blending import object_map
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import PosedCamera
from tests.benchmarks.evaluation import made_data

IDS = (3, 4, 8)
POSED = PosedCamera(made_data.CAMERA.scaled_to(256, 192), np.eye(4), "a.png")


def _scene(objects: Objects | None = None) -> Scene:
    """Three balls, each an object of its own id."""
    membership = evidence_of(np.arange(3), np.array(IDS), np.full(3, 1 << 18), 3)
    default_objects = Objects(tuple(Object(number, consensus=1 - number / 100) for number in IDS), membership)
    return replace(made_data.scene(), objects=objects or default_objects)


def _dataset(truth: np.ndarray) -> Dataset:
    view = TrueView("a.png", POSED, instances=truth.astype(np.int32))
    return Dataset(
        Path("made"), "nerfstudio", made_data.scene().dictionary, ("b.png",), (view,), instances=("ball",) * 3
    )


def _truth() -> np.ndarray:
    """What the scene shows, its objects numbered from 1."""
    id_map = object_map(_scene(), POSED)
    return np.searchsorted([0, *IDS], id_map)


def test_the_map_shows_ids_of_objects() -> None:
    id_map = object_map(_scene(), POSED)
    assert set(np.unique(id_map)) == {0, *IDS}
    columns = [np.nonzero(id_map == number)[1].mean() for number in IDS]
    assert columns == sorted(columns)  # the balls stand in a row
    with pytest.raises(InvalidInputError, match="no objects"):
        object_map(made_data.scene(), POSED)


def test_what_lies_where_nothing_is_named_is_neither_right_nor_wrong() -> None:
    pixels = np.array([[500, 0, 400, 70], [0, 300, 0, 0], [0, 0, 90, 80]])
    counts = ObjectCounts(pixels)
    assert counts.judged.tolist() == [True, False, True]
    assert precision_at(counts, 0.5) == 1 / 2
