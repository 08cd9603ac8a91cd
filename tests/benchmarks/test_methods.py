"""Other methods keep labels as their papers say, on Gaussians that stay as they are, and are measured as ours are."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.methods.fields import FeatureField, HardField, Vocabulary
from benchmarks.methods.lifting import distill_features, lift_features, majority_labels
from benchmarks.methods.scoring import ProductField, score
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.evaluation.datasets.reading import read_dataset
from fastsplat.service.query.embeddings import embed_names
from fastsplat.service.scene.types import Gaussians
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.rendering import label_sums
from fastsplat.service.splatting.training_views import Frame, TrainingView
from fastsplat_contract.camera import PosedCamera
from tests.evaluation import made_data

_CAMERA = made_data.CAMERA


def _view(pose: np.ndarray, labels: np.ndarray, valid: np.ndarray | None = None) -> TrainingView:
    viewmat = torch.tensor(np.linalg.inv(pose), dtype=torch.float32)
    rgb = torch.zeros(*labels.shape, 3, dtype=torch.uint8)
    mask = None if valid is None else torch.from_numpy(valid)
    frame = Frame(_CAMERA, rgb, torch.from_numpy(labels.astype(np.int32)), mask)
    return TrainingView("v", viewmat, torch.tensor(pose[:3, 3], dtype=torch.float32), (frame,))


@pytest.fixture(scope="module")
def gaussians() -> Gaussians:
    return made_data.scene().gaussians


@pytest.fixture(scope="module")
def views() -> tuple[TrainingView, ...]:
    index = made_data.index()
    return tuple(_view(pose, index.label_map(PosedCamera(_CAMERA, pose))) for pose in made_data.poses(4))


@pytest.fixture(scope="module")
def words() -> Vocabulary:
    encoder = made_data.WordEncoder()
    return Vocabulary(
        embed_names(made_data.LABELS, encoder, ("{}",)), embed_names(("object", "stuff"), encoder, ("{}",))
    )


def test_lifted_features_are_the_mean_by_blend_weight(gaussians: Gaussians, words: Vocabulary) -> None:
    """Against the sums by label, which the rasterizer computes another way; undetected pixels count for nothing."""
    labels = np.random.default_rng(0).integers(0, 4, (48, 64))
    views = [_view(pose, labels) for pose in made_data.poses(2)]
    weights = sum(
        label_sums(splats_of(gaussians), view.viewmat, _CAMERA, torch.from_numpy(labels.astype(np.int32)), 4).dense(4)[
            :, 1:
        ]
        for view in views
    )
    expected = (weights @ torch.from_numpy(words.labels).double()) / weights.sum(dim=1, keepdim=True)
    assert lift_features(gaussians, views, words.labels).numpy() == pytest.approx(expected.numpy(), abs=1e-4)


def test_the_majority_wins_whatever_nobody_named_and_what_is_not_valid_does_not_vote(gaussians: Gaussians) -> None:
    pose = made_data.poses(1)[0]
    labels = np.zeros((48, 64), int)
    labels[:, :36], labels[20:24, 20:] = 2, 3
    middle = (24, 32)  # the second ball's center lies here
    assert labels[middle] == 2
    assert majority_labels(gaussians, [_view(pose, labels)], 3)[:2].tolist() == [2, 2]
    valid = np.ones((48, 64), bool)
    valid[:, :36] &= labels[:, :36] != 2
    assert majority_labels(gaussians, [_view(pose, labels, valid)], 3)[1] == 3
    assert majority_labels(gaussians, [_view(pose, np.zeros((48, 64), int))], 3).tolist() == [0, 0, 0]


def test_what_no_labelled_pixel_shows_has_no_class(gaussians: Gaussians, words: Vocabulary) -> None:
    nothing = [_view(made_data.poses(1)[0], np.zeros((48, 64), int))]
    features = lift_features(gaussians, nothing, words.labels)
    assert not features.any() and FeatureField(gaussians, features, None, words).classes.tolist() == [0, 0, 0]


def test_every_method_finds_exact_labels_again_and_leaves_the_gaussians_alone(
    gaussians: Gaussians, views: tuple[TrainingView, ...], words: Vocabulary, tmp_path: Path
) -> None:
    before = {item.name: getattr(gaussians, item.name).copy() for item in fields(gaussians)}
    dataset = read_dataset(made_data.nerfstudio(tmp_path / "made"), CaptureSettings())
    features, decoder = distill_features(gaussians, views, words.labels, size=4, steps=120)
    assert features.shape == (3, 4) and decoder.shape == (4, words.labels.shape[1])
    index = made_data.index()
    ours = score(ProductField(index, dataset), gaussians, index.render, dataset)
    assert ours["miou"] == pytest.approx(1) == ours["mask3d_iou"]
    for field in (
        FeatureField(gaussians, lift_features(gaussians, views, words.labels), None, words),
        FeatureField(gaussians, features, decoder, words),
        HardField(gaussians, majority_labels(gaussians, views, 3), words),
    ):
        assert field.classes.tolist() == [1, 2, 3]
        figures = score(field, gaussians, index.render, dataset)
        assert figures["miou"] > 0.9 and figures["mask3d_iou"] == 1 == figures["localization"]
        assert figures["miou_opengaussian"] == pytest.approx(ours["miou_opengaussian"])
    assert all((before[name] == getattr(gaussians, name)).all() for name in before)


def test_relevancy_is_highest_where_the_text_is_and_a_pixel_has_the_shares_of_its_labels(
    gaussians: Gaussians, words: Vocabulary
) -> None:
    posed = PosedCamera(_CAMERA, np.eye(4))
    drawn = HardField(gaussians, [1, 0, 3], words).draw(posed)
    assert set(np.unique(drawn.label_map)) == {0, 1, 3} and drawn.label_map[24, 32] == 0
    for label in (1, 3):
        peak = np.unravel_index(drawn.relevancy[label - 1].argmax(), drawn.label_map.shape)
        assert drawn.label_map[peak] == label
    exact = FeatureField(gaussians, torch.from_numpy(words.labels), None, words).draw(posed)
    own = 1 / (1 + np.exp(-10 * (1 - (words.labels @ words.negatives.T).max(axis=1))))
    for label in (1, 2, 3):
        inside = exact.relevancy[label - 1][exact.label_map == label]
        assert inside.max() == pytest.approx(own[label - 1], abs=1e-4)
    assert exact.relevancy.min() == 0 and exact.relevancy.max() <= 1


def test_figures_that_a_data_set_has_no_truth_for_are_none(
    gaussians: Gaussians, words: Vocabulary, tmp_path: Path
) -> None:
    dataset = read_dataset(made_data.nerfstudio(tmp_path / "made", drop=("depth_path",)), CaptureSettings())
    figures = score(HardField(gaussians, [2, 2, 2], words), gaussians, made_data.index().render, dataset)
    assert figures["mask3d_iou"] is None and figures["miou"] < 0.5
