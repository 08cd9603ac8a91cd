"""A scene that is known exactly scores perfectly on every layout; what is wrong, missing or leaked does not."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.evaluation.datasets.reading import read_dataset
from fastsplat.service.evaluation.datasets.types import Dataset, QueryTruth, TrueView
from fastsplat.service.evaluation.evaluation_report import Report, RunCost
from fastsplat.service.evaluation.registry import METRICS
from fastsplat.service.evaluation.scene_evaluation import evaluate_scene
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat_contract.camera import PosedCamera
from fastsplat_contract.errors import InvalidInputError
from tests.evaluation import made_data

KEYS = (*(metric.name for metric in METRICS), "miou_per_class", "gaussians", "bytes", "seconds", "peak_mb", "queries")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = made_data.nerfstudio(tmp_path_factory.mktemp("truth") / "made", 6, (0, 1, 2, 3, 4))
    return read_dataset(folder, CaptureSettings())


def _renamed(names: tuple[str, ...]) -> SceneIndex:
    return made_data.index(made_data.scene(names))


def _value(report: Report, name: str) -> float:
    value = report.value(name)
    assert value is not None
    return value


def test_every_metric_has_a_name_of_its_own_and_says_what_it_is() -> None:
    names = [metric.name for metric in METRICS]
    assert len(set(names)) == len(names)
    assert all(metric.description and metric.unit in ("", "dB", "scene units") for metric in METRICS)


def test_the_truth_scores_perfectly_and_the_report_has_every_key(dataset: Dataset) -> None:
    cost = RunCost(seconds={"training": 3.0}, peak_mb=7.0)
    report = evaluate_scene(made_data.index(), dataset, cost=cost, samples=50)
    for name in ("miou", "pixel_accuracy", "boundary_iou", "localization", "mask3d_iou", "ssim", "depth_coverage"):
        assert report.value(name) == pytest.approx(1)
    assert report.figures["miou"].per_label == dict.fromkeys(made_data.LABELS, 1)
    assert report.value("ghost_rate") == 0 and _value(report, "depth_error") < 1e-3
    assert report.gaussians == 3 and report.bytes > 100
    written = report.to_json()
    assert set(KEYS) <= set(written)
    assert set(written["seconds"]) == {"training", "scoring"} and written["peak_mb"] == 7
    assert written["psnr"] is None and "equal" in written["reasons"]["psnr"]  # equal images: infinite
    assert set(written["skipped"]["psnr"]) == {view.name for view in dataset.test}
    assert written["metrics"]["psnr"]["unit"] == "dB" and not written["metrics"]["ghost_rate"]["higher_is_better"]
    assert written["miou_micro"] == 1 == written["miou_threshold"] == written["localization_peak_in_mask"]
    assert written["intervals"]["miou"] == [1, 1]
    assert written["absent"]["texts"] >= 100 and "name" in written["metrics"]["absent_auroc"]["description"]
    assert len(written["queries"]) == 5 * 3
    json.dumps(written, allow_nan=False)


def test_the_order_of_images_changes_nothing(dataset: Dataset) -> None:
    index = _renamed((made_data.LABELS[0], made_data.LABELS[2], made_data.LABELS[1]))
    turned = replace(dataset, test=dataset.test[::-1])
    first, second = (evaluate_scene(index, each, samples=50).to_json() for each in (dataset, turned))
    assert first.pop("seconds") and second.pop("seconds")
    assert first == second


def test_two_labels_exchanged_lose_their_share_and_nothing_else(dataset: Dataset) -> None:
    index = _renamed((made_data.LABELS[0], made_data.LABELS[2], made_data.LABELS[1]))
    report = evaluate_scene(index, dataset, samples=0)
    assert report.figures["miou"].per_label == {"red mug": 1, "green spoon": 0, "blue bed": 0}
    assert report.value("miou") == pytest.approx(1 / 3) == report.value("mask3d_iou") == report.value("localization")
    assert report.value("miou_threshold") == pytest.approx(1 / 3)
    assert report.value("psnr") is None and "equal" in report.figures["psnr"].reason


def test_a_label_that_the_scene_does_not_have_counts_as_zero(dataset: Dataset) -> None:
    report = evaluate_scene(_renamed((*made_data.LABELS[:2], "purple elephant")), dataset, samples=0)
    assert report.figures["miou"].per_label["blue bed"] == 0
    assert report.value("miou") == pytest.approx(2 / 3) == report.value("miou_threshold")
    asked = [query for query in report.queries if query.text == "blue bed"]
    assert asked and all(query.outcome == "not_here" and query.iou_threshold == 0 for query in asked)


def test_a_missing_prediction_lowers_every_figure(dataset: Dataset) -> None:
    index = made_data.index()
    whole = evaluate_scene(index, dataset, samples=0)
    lost = TrueView("lost", None, labels=dataset.test[0].labels)
    # A map of a view without a pose has no camera to say its size, so the annotated kind is used.
    queries = tuple(
        QueryTruth(label, lost.labels == number, ((0.0, 0.0, 64.0, 48.0),))
        for number, label in enumerate(made_data.LABELS, 1)
    )
    less = replace(dataset, test=(*dataset.test, TrueView("lost", None, queries=queries)))
    report = evaluate_scene(index, less, samples=0)
    for name in ("miou", "boundary_iou", "localization", "pixel_accuracy"):
        assert _value(report, name) < _value(whole, name)
    for name in ("miou_micro", "miou_views", "miou_threshold", "localization_peak_in_mask"):
        assert _value(report, name) < _value(whole, name)
    assert report.value("miou_views") == pytest.approx(5 / 6) == report.value("localization")


@pytest.mark.parametrize("more", [0, 2_000])
def test_a_scene_of_no_label_or_of_very_many_is_scored(dataset: Dataset, more: int) -> None:
    scene = made_data.scene()
    names = (*made_data.LABELS, *(f"kind {number}" for number in range(more))) if more else ()
    labels = dictionary_of(names)
    codes = scene.gaussians.codes if more else np.zeros((3, 0), np.float32)
    weight = np.zeros((len(names) + 1, codes.shape[1]), np.float32)
    weight[:4] = scene.head.weight[: len(weight)] if more else weight[:4]
    bias = np.full(len(names) + 1, -9, np.float32)
    bias[:4] = 0
    bias[0] = 4
    other = replace(
        scene,
        gaussians=replace(scene.gaussians, codes=codes),
        head=replace(scene.head, weight=weight, bias=bias),
        dictionary=labels,
        label_embeddings=np.resize(scene.label_embeddings, (len(names), scene.label_embeddings.shape[1])),
    )
    few = replace(dataset, test=dataset.test[:1])
    report = evaluate_scene(made_data.index(other), few, samples=20)
    assert report.value("miou") == (1 if more else 0) == report.value("mask3d_iou")
    json.dumps(report.to_json(), allow_nan=False)


def test_pixels_that_do_not_count_do_not_count(dataset: Dataset) -> None:
    index = _renamed((made_data.LABELS[0], made_data.LABELS[2], made_data.LABELS[1]))
    left = tuple(replace(view, valid=np.broadcast_to(np.arange(64) < 22, (48, 64))) for view in dataset.test)
    assert evaluate_scene(index, replace(dataset, test=left), samples=0).value("miou") == 1


def test_a_scene_that_saw_a_test_view_is_refused_by_name_and_by_pose(dataset: Dataset) -> None:
    view = dataset.test[2]
    for name in (view.name, "another name.png"):
        cheat = replace(made_data.scene(), cameras=(PosedCamera(made_data.CAMERA, view.posed.world_from_camera, name),))
        with pytest.raises(InvalidInputError, match="trained on the test view"):
            evaluate_scene(made_data.index(cheat), dataset)
        held_out = replace(cheat, quality={"held_out_views": [name]})
        assert evaluate_scene(made_data.index(held_out), dataset, samples=0).value("miou") == 1


def test_a_scene_in_another_world_frame_is_refused(dataset: Dataset) -> None:
    pose = dataset.test[0].posed.world_from_camera.copy()
    pose[2, 3] += 1
    moved = PosedCamera(made_data.CAMERA, pose, dataset.test[0].name)
    other = replace(made_data.scene(), cameras=(moved,), quality={"held_out_views": [moved.name]})
    with pytest.raises(InvalidInputError, match="another pose"):
        evaluate_scene(made_data.index(other), dataset)


def test_annotated_frames_are_scored_per_query_and_nothing_is_forced(tmp_path: Path) -> None:
    folder = made_data.lerf_ovs(tmp_path, [1, 2, 3, 4], [2, 3])
    truth = made_data.index()
    read = read_dataset(folder, CaptureSettings())
    views = []
    for view in read.test:
        shown = truth.label_map(view.posed)
        queries = [
            QueryTruth("red mug", shown == 1, ((0, 0, 64, 48),)),
            QueryTruth("sofa", shown == 2, ((0, 0, 1, 1),)),
        ]
        views.append(replace(view, queries=tuple(queries)))
    dataset = replace(read, test=tuple(views), dictionary=dictionary_of(["red mug", "sofa"]))
    report = evaluate_scene(truth, dataset, samples=0)
    assert report.figures["miou"].per_label["red mug"] == 1
    assert report.figures["miou_threshold"].per_label == {"red mug": 1, "sofa": 0}
    sofas = [query for query in report.queries if query.text == "sofa"]
    assert all(query.outcome == "not_here" and query.iou_threshold == 0 for query in sofas)
    written = report.to_json()
    assert written["ghost_rate"] is None and written["mask3d_iou"] is None and written["depth_error"] is None
    assert {"ghost_rate", "mask3d_iou", "depth_error"} <= set(written["reasons"])


def test_three_layouts_of_one_truth_give_one_figure(tmp_path: Path) -> None:
    scene = made_data.scene()
    shaken = scene.gaussians.means + np.array([[0.04, 0, 0], [0, 0.06, 0], [-0.3, 0, 0.1]], np.float32)
    index = made_data.index(replace(scene, gaussians=replace(scene.gaussians, means=shaken.astype(np.float32))))
    maps, masks, polygons = (
        evaluate_scene(index, read_dataset(folder, CaptureSettings()), samples=0)
        for folder in made_data.same_truth(tmp_path)
    )
    assert 0.2 < _value(maps, "miou") < 0.95
    names = ("miou", "boundary_iou", "pixel_accuracy", "localization")
    names += ("miou_micro", "miou_views", "miou_threshold", "miou_threshold_views")
    for other in (masks, polygons):
        assert other.figures["miou"].per_label == pytest.approx(maps.figures["miou"].per_label)
        for name in names:
            assert other.value(name) == pytest.approx(maps.value(name)), name


def test_a_data_set_without_labels_measures_pictures_alone(tmp_path: Path) -> None:
    dataset = read_dataset(made_data.colmap(tmp_path / "plain", ["a", "b", "c"]), CaptureSettings())
    written = evaluate_scene(made_data.index(), dataset).to_json()
    assert written["psnr"] > 0 and written["ssim"] is not None
    for name in ("miou", "localization", "pixel_accuracy", "boundary_iou", "absent_auroc"):
        assert written[name] is None and written["reasons"][name]
    assert written["miou_per_class"] == {}


def test_black_and_masked_views_are_skipped_by_name_and_leave_no_nan(dataset: Dataset) -> None:
    black, masked, plain = (view.name for view in dataset.test[:3])
    beside = np.eye(4)
    beside[0, 3] = 50  # nothing of the scene is visible from here
    changed = (
        replace(
            dataset.test[0],
            posed=PosedCamera(made_data.CAMERA, beside, black),
            rgb=np.zeros((48, 64, 3), np.uint8),
            labels=np.zeros((48, 64), np.int32),
        ),
        replace(dataset.test[1], valid=np.zeros((48, 64), bool)),
        replace(dataset.test[2], rgb=made_data.picture(3)),
    )
    report = evaluate_scene(made_data.index(), replace(dataset, test=changed), samples=50)
    written = report.to_json()
    json.dumps(written, allow_nan=False)
    skipped = written["skipped"]
    assert set(skipped["psnr"]) == {black, masked} and set(skipped["ssim"]) == {masked}
    assert "equal" in skipped["psnr"][black] and "mask" in skipped["psnr"][masked]
    rows = {row["name"]: row for row in written["views"]}
    assert written["psnr"] == rows[plain]["psnr"] > 0 and rows[black]["psnr"] is None
    assert written["miou"] == 1  # of the plain view, the only one that shows a label


def test_a_metric_is_measured_or_says_why_not(dataset: Dataset, tmp_path: Path) -> None:
    plain = read_dataset(made_data.colmap(tmp_path / "plain", ["a", "b", "c"]), CaptureSettings())
    for truth in (dataset, plain):
        figures = evaluate_scene(made_data.index(), truth, samples=0).figures
        assert list(figures) == [metric.name for metric in METRICS]
        for figure in figures.values():
            assert (figure.value is None) == bool(figure.reason)
            assert figure.value is None or np.isfinite(figure.value)
