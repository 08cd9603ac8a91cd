"""A scene that is known exactly scores perfectly on every layout; what is wrong, missing or leaked does not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.evaluation.datasets.dataset import Dataset, QueryTruth, TrueView
from benchmarks.evaluation.datasets.reading import read_dataset
from benchmarks.evaluation.registry import METRICS
from benchmarks.evaluation.scene_evaluation import evaluate_scene
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene_facts import SceneFacts
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import PosedCamera
from tests.benchmarks.evaluation import made_data


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = made_data.nerfstudio(tmp_path_factory.mktemp("truth") / "made", 6, (0, 1, 2, 3, 4))
    return read_dataset(folder, CaptureSettings())


def _renamed(names: tuple[str, ...]) -> SceneIndex:
    return made_data.index(made_data.scene(names))


def _figures(index: SceneIndex, dataset: Dataset) -> dict[str, float]:
    """Those that were measured."""
    figures = evaluate_scene(index, dataset).figures
    return {name: value for name, value in figures.items() if value is not None}


def test_the_truth_scores_perfectly(dataset: Dataset) -> None:
    report = evaluate_scene(made_data.index(), dataset)
    for name in ("miou", "miou_views", "boundary_iou", "localization", "ssim"):
        assert report.figures[name] == pytest.approx(1)
    assert report.figures["depth_error"] < 1e-3
    assert report.figures["psnr"] is None and "equal" in report.reasons["psnr"]  # equal images: infinite


def test_two_labels_exchanged_lose_their_share_and_nothing_else(dataset: Dataset) -> None:
    report = evaluate_scene(_renamed((made_data.LABELS[0], made_data.LABELS[2], made_data.LABELS[1])), dataset)
    for name in ("miou", "miou_views", "localization", "miou_lerf_mask"):
        assert report.figures[name] == pytest.approx(1 / 3)
    assert report.figures["psnr"] is None and "equal" in report.reasons["psnr"]


def test_a_label_that_the_scene_does_not_have_counts_as_zero(dataset: Dataset) -> None:
    figures = _figures(_renamed((*made_data.LABELS[:2], "purple elephant")), dataset)
    assert figures["miou"] == pytest.approx(2 / 3) == figures["miou_lerf_mask"]


def test_a_missing_prediction_lowers_every_figure(dataset: Dataset) -> None:
    index = made_data.index()
    whole = _figures(index, dataset)
    # A map of a view without a pose has no camera to say its size, so the annotated kind is used.
    queries = tuple(
        QueryTruth(label, dataset.test[0].labels == number, ((0.0, 0.0, 64.0, 48.0),))
        for number, label in enumerate(made_data.LABELS, 1)
    )
    less = _figures(index, replace(dataset, test=(*dataset.test, TrueView("lost", None, queries=queries))))
    for name in ("miou", "miou_views", "boundary_iou", "localization", "miou_lerf_mask"):
        assert less[name] < whole[name]
    assert less["miou_views"] == pytest.approx(5 / 6) == less["localization"]


def test_pixels_that_do_not_count_do_not_count(dataset: Dataset) -> None:
    index = _renamed((made_data.LABELS[0], made_data.LABELS[2], made_data.LABELS[1]))
    left = tuple(replace(view, valid=np.broadcast_to(np.arange(64) < 22, (48, 64))) for view in dataset.test)
    assert _figures(index, replace(dataset, test=left))["miou"] == 1


def test_a_scene_that_saw_a_test_view_is_refused_by_name_and_by_pose(dataset: Dataset) -> None:
    view = dataset.test[2]
    for name in (view.name, "another name.png"):
        cheat = replace(made_data.scene(), cameras=(PosedCamera(made_data.CAMERA, view.posed.world_from_camera, name),))
        with pytest.raises(InvalidInputError, match="trained on the test view"):
            evaluate_scene(made_data.index(cheat), dataset)
        held_out = replace(cheat, facts=SceneFacts(held_out_views=(name,)))
        assert _figures(made_data.index(held_out), dataset)["miou"] == 1


def test_a_scene_in_another_world_frame_is_refused(dataset: Dataset) -> None:
    pose = dataset.test[0].posed.world_from_camera.copy()
    pose[2, 3] += 1
    moved = PosedCamera(made_data.CAMERA, pose, dataset.test[0].name)
    moved_scene = replace(made_data.scene(), cameras=(moved,), facts=SceneFacts(held_out_views=(moved.name,)))
    with pytest.raises(InvalidInputError, match="another pose"):
        evaluate_scene(made_data.index(moved_scene), dataset)


def test_annotated_frames_are_scored_per_query_and_nothing_is_forced(tmp_path: Path) -> None:
    folder = made_data.lerf_ovs(tmp_path, [1, 2, 3, 4], [2, 3])
    truth = made_data.index()
    read = read_dataset(folder, CaptureSettings())
    views = []
    for view in read.test:
        label_map = truth.label_map(view.posed)
        queries = [
            QueryTruth("red mug", label_map == 1, ((0, 0, 64, 48),)),
            QueryTruth("sofa", label_map == 2, ((0, 0, 1, 1),)),
        ]
        views.append(replace(view, queries=tuple(queries)))
    dataset = replace(read, test=tuple(views), dictionary=dictionary_of(["red mug", "sofa"]))
    figures = _figures(truth, dataset)
    assert figures["miou"] == 0.5 == figures["miou_lerf_mask"] and figures["miou_lerf_mask_lenient"] == 1
    assert "depth_error" not in figures


def test_three_layouts_of_one_truth_give_one_figure(tmp_path: Path) -> None:
    scene = made_data.scene()
    shaken = scene.gaussians.means + np.array([[0.04, 0, 0], [0, 0.06, 0], [-0.3, 0, 0.1]], np.float32)
    index = made_data.index(replace(scene, gaussians=replace(scene.gaussians, means=shaken.astype(np.float32))))
    maps, masks, polygons = (
        _figures(index, read_dataset(folder, CaptureSettings())) for folder in made_data.same_truth(tmp_path)
    )
    assert 0.2 < maps["miou"] < 0.95
    for name in ("miou", "miou_views", "boundary_iou", "localization", "miou_lerf_mask"):
        assert masks[name] == pytest.approx(maps[name]) == polygons[name], name


def test_black_and_masked_views_are_skipped_and_leave_no_nan(dataset: Dataset) -> None:
    beside = np.eye(4)
    beside[0, 3] = 50  # nothing of the scene is visible from here
    changed = (
        replace(
            dataset.test[0],
            posed=PosedCamera(made_data.CAMERA, beside, dataset.test[0].name),
            rgb=np.zeros((48, 64, 3), np.uint8),
            labels=np.zeros((48, 64), np.int32),
        ),
        replace(dataset.test[1], valid=np.zeros((48, 64), bool)),
        replace(dataset.test[2], rgb=made_data.picture(3)),
    )
    figures = _figures(made_data.index(), replace(dataset, test=changed))
    alone = _figures(made_data.index(), replace(dataset, test=changed[2:]))
    assert figures["psnr"] == alone["psnr"] > 0
    assert figures["miou"] == 1  # of the plain view, the only one that shows a label


def test_a_metric_is_measured_or_says_why_not(dataset: Dataset, tmp_path: Path) -> None:
    plain = read_dataset(made_data.colmap(tmp_path / "plain", ["a", "b", "c"]), CaptureSettings())
    for truth in (dataset, plain):
        report = evaluate_scene(made_data.index(), truth)
        assert list(report.figures) == [metric.name for metric in METRICS]
        for name, value in report.figures.items():
            assert (value is None) == bool(report.reasons.get(name))
            assert value is None or np.isfinite(value)
