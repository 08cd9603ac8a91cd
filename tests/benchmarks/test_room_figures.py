"""Figures of drawn rooms: a scene that is the truth is perfect by each of them, and each sees its own fault."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.evaluation.datasets.dataset import Dataset, TrueView
from benchmarks.evaluation.object_discovery import count_objects
from benchmarks.rooms.figures import MARGIN, Measured, figures_of
from benchmarks.rooms.truth import Truth
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.scene.artefact.scene import Object, Objects
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from tests.scenes import labelled_scene

_CAMERA = PosedCamera(Camera(80, 60, 60.0, 60.0, 40.0, 30.0), np.eye(4), "0.jpg")
_LABELS = ("wall", "cup", "hammer", "book")
_HALF = 0.1


def _truth_and_map() -> tuple[Truth, np.ndarray]:
    """A wall at depth 2 with three squares before it at depth 1, and the object of each pixel."""
    middles = np.array([[0, 0, 2.0], [-0.4, 0, 1.0], [0, 0, 1.0], [0.4, 0, 1.0]])
    halves = np.array([[1.6, 1.2, 0.0], *[[_HALF, _HALF, 0.0]] * 3])
    x, y = np.meshgrid((np.arange(80) + 0.5 - 40) / 60, (np.arange(60) + 0.5 - 30) / 60)
    alone = np.stack(
        [
            (np.abs(x * z - a) <= b) & (np.abs(y * z - c) <= d)
            for (a, c, z), (b, d, _) in zip(middles, halves, strict=True)
        ]
    )
    object_map = np.ones((60, 80), np.int32)
    for number in (2, 3, 4):
        object_map[alone[number - 1]] = number
    rng = np.random.default_rng(0)
    points = np.concatenate(
        [middle + half * rng.uniform(-1, 1, (900, 3)) for middle, half in zip(middles, halves, strict=True)]
    )
    truth = Truth(
        labels=_LABELS,
        surfaces=("wall", "", "", ""),
        axes=np.tile(np.eye(3), (4, 1, 1)),
        low=middles - halves,
        high=middles + halves,
        points=points.astype(np.float32),
        owners=np.repeat(np.arange(1, 5, dtype=np.int32), 900),
        names=("0.jpg",),
        silhouettes=alone[None],
        parts=(alone[2] & (y < 0))[None].astype(np.uint8),
        part_names=("head",),
    )
    return truth, object_map


def _measured(
    object_map: np.ndarray | None = None, names: dict[int, str] | None = None, fog: float = 0.0, taken: int = 0
) -> Measured:
    """The truth as flat Gaussians; of each object a share is moved away, and so many of the third are the second's."""
    truth, true = _truth_and_map()
    object_map = true if object_map is None else object_map
    count = len(truth.points)
    means = truth.points.copy()
    moved = np.tile(np.arange(900) < fog * 900, 4) & (truth.owners > 1)
    means[moved, 2] -= 3 * MARGIN
    named = names or {}
    ids = range(1, max(4, int(object_map.max())) + 1)
    sure = {"cup": 0.96, "knife": 0.9}  # one is stated, one a guess
    table = tuple(
        Object(number, name, "detected" if name else None, sure.get(name, 0.0))
        for number, name in ((object_id, named.get(object_id, "")) for object_id in ids)
    )
    owners = truth.owners.copy()
    owners[np.flatnonzero(owners == 3)[:taken]] = 2
    membership = evidence_of(np.arange(count), owners, np.full(count, UNIT, np.int64), count)
    scene = labelled_scene(
        means, np.zeros(count, int), (), scales=0.004, logit_opacities=4.0, objects=Objects(table, membership)
    )
    view = TrueView("0.jpg", _CAMERA, instances=true)
    dataset = Dataset(Path("made"), "nerfstudio", dictionary_of(()), (), (view,), instances=_LABELS)
    objects = {"0.jpg": object_map}
    return Measured(scene, dataset, truth, objects, {"0.jpg": 0 * object_map}, count_objects(scene, dataset, objects))


def test_the_truth_is_perfect() -> None:
    figures = figures_of(_measured())
    for name in ("recall_50", "recall_75", "precision", "mean_iou", "clicks_miou", "selected_miou", "surfaces_iou"):
        assert figures[name] == 1, name
    assert figures["wall_iou"] == 1 and figures["outside_box"] == 0 and figures["objects_true"] == 4
    assert figures["covered"] > 0.95 and figures["alone_miou"] > 0.7


def test_fog_lies_outside_the_box_of_its_object() -> None:
    figures = figures_of(_measured(fog=0.25))
    assert figures["outside_box"] == pytest.approx(0.25, abs=0.01) and figures["outside_at_others"] == 0


def test_what_is_taken_from_another_object_is_no_fog() -> None:
    figures = figures_of(_measured(taken=300))
    assert figures["outside_box"] == figures["outside_at_others"] == pytest.approx(0.25 / 3, abs=0.001)


def test_two_that_are_one_are_no_object_and_pieces_are_joined_by_a_second_click() -> None:
    _, true = _truth_and_map()
    merged = figures_of(_measured(np.where(true == 3, 2, true)))
    assert (merged["recall_75"], merged["precision"]) == (2 / 4, 1) and merged["clicks_miou"] == 0.625
    pieces = true.copy()
    pieces[:20][true[:20] == 1] = 5  # the upper third of the wall is an object of its own
    split = figures_of(_measured(pieces))
    assert split["selected_miou"] < 0.95 and split["clicks_1.3_miou"] == 1
    assert (split["recall_75"], split["precision"]) == (3 / 4, 4 / 5)


def test_an_object_that_is_missing_costs_recall_and_its_click_names_nothing() -> None:
    _, true = _truth_and_map()
    missing = figures_of(_measured(np.where(true == 3, 0, true)))
    assert (missing["recall_50"], missing["precision"], missing["clicks_miou"]) == (3 / 4, 1, 3 / 4)


def test_a_part_under_the_click_may_be_what_is_meant() -> None:
    _, true = _truth_and_map()
    measured = _measured(np.where(true == 3, 2, true))
    assert figures_of(measured)["parts_recall_50"] == 0
    with_parts = replace(measured, parts={"0.jpg": np.choose(true, (0, 0, 7, 8, 0)).astype(np.int32)})
    assert figures_of(with_parts)["clicks_1.3_miou"] > figures_of(measured)["clicks_1.3_miou"]


def test_a_part_is_known_by_a_part_or_an_object_that_is_as_large() -> None:
    truth, true = _truth_and_map()
    with_head = _measured(np.where(truth.parts[0] == 1, 5, true))
    assert figures_of(with_head)["parts_recall_50"] == 1 and figures_of(with_head)["parts_true"] == 1


def test_names_are_right_or_not_and_known_or_not() -> None:
    figures = figures_of(_measured(names={2: "cup", 3: "knife"}))
    counted = {name: value for name, value in figures.items() if name.startswith("names")}
    assert counted == {
        "names_given": 2,
        "names_given_right": 1,
        "names_stated": 1,
        "names_stated_right": 1,
        "names_knowable": 2,
        "names_known": 1,
    }
