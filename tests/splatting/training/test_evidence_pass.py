"""The evidence pass: a sum over the training views alone, to which views are added and from which they are taken."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
import torch

from fastsplat.service.capture.captures import Capture
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.common.progress import silent
from fastsplat.service.perception.results import Labelling
from fastsplat.service.scene.artefact.scene import Evidence
from fastsplat.service.scene.objects.label_evidence import merged, posterior, seen_pixels
from fastsplat.service.splatting.labels.view_evidence import view_evidence, views_evidence
from fastsplat.service.splatting.raster.image_formation import Splats
from fastsplat.service.splatting.raster.rendering import accumulate_weights
from fastsplat.service.splatting.results import TrainedSplats
from fastsplat.service.splatting.training.train import train
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat.service.splatting.training_views import drop_empty_label_maps, load_views, split_views
from fastsplat_contract.errors import InvalidInputError

CLASSES = 4
World = tuple[Capture, Labelling]


def same(a: Evidence, b: Evidence) -> bool:
    return all(np.array_equal(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(Evidence))


@pytest.fixture(scope="module")
def trained(world: World) -> TrainedSplats:
    """A scene in evidence mode, a few hundred steps old."""
    settings = TrainingSettings(
        iterations=200, time_budget_s=None, max_gaussians=300, evaluations=0, label_mode="evidence"
    )
    return train(*world, settings, silent)


def of_views(trained: TrainedSplats, world: World, indices: tuple[int, ...]) -> Evidence:
    return views_evidence(trained.gaussians, load_views(*world, indices, 640, (1.0,)), CLASSES, undetected_weight=0.1)


def test_a_run_in_evidence_mode_names_its_gaussians_without_codes(trained: TrainedSplats, world: World) -> None:
    assert trained.evidence is not None
    assert trained.gaussians.codes.shape[1] == 0 and trained.quality["evidence_seconds"] > 0
    training_views, held_out = split_views(len(world[0].views), 8)
    assert trained.held_out == tuple(world[0].views[index].posed.name for index in held_out)
    assert same(trained.evidence, of_views(trained, world, training_views))
    found = posterior(trained.evidence, CLASSES)
    red = trained.gaussians.sh[:, 0, 0] - trained.gaussians.sh[:, 0, 1:].max(axis=1)
    ball = (found.classes == 2) & (found.confidence > 0.9) & (seen_pixels(trained.evidence) > 5)
    assert ball.sum() > 5 and (red[ball] > 0).mean() > 0.9  # what is called ball is red


def test_views_can_be_added_to_the_bit(trained: TrainedSplats, world: World) -> None:
    first, second = of_views(trained, world, (0, 1, 2)), of_views(trained, world, (3,))
    assert same(merged([first, second]), of_views(trained, world, (0, 1, 2, 3)))


def test_evidence_is_the_blend_weight_over_the_pixels_of_a_label(trained: TrainedSplats, world: World) -> None:
    capture, labelling = world
    view, labels = capture.views[0].posed, labelling.label_maps[0]
    valid = np.ones(labels.shape, bool)
    valid[:, :20] = False
    found = view_evidence(trained.gaussians, view, labels, CLASSES, valid=valid, undetected_weight=0.25)
    g = trained.gaussians
    parts = [torch.from_numpy(np.asarray(array)) for array in (g.means, g.quats, g.log_scales, g.logit_opacities)]
    splats = Splats(parts[0], parts[1], parts[2].exp(), parts[3].sigmoid(), torch.zeros(len(g), 0))
    one_hot = np.eye(CLASSES, dtype=np.float32)[labels] * valid[..., None] * np.array([0.25, 1, 1, 1], np.float32)
    viewmat = torch.from_numpy(view.camera_from_world().astype(np.float32))
    expected = accumulate_weights(splats, viewmat, view.camera, torch.from_numpy(one_hot), backend="reference").numpy()
    table = np.zeros_like(expected)
    table[np.repeat(np.arange(len(g)), np.diff(found.starts)), found.labels] = found.counts / 4096
    np.testing.assert_allclose(table, expected, atol=2e-2)


@pytest.mark.parametrize("mode", ["codes", "evidence"])
def test_every_pixel_undetected_trains_a_scene_without_names(
    world: World, quick: Callable[..., TrainingSettings], mode: str
) -> None:
    capture, labelling = world
    nothing = Labelling(labelling.dictionary, tuple(m * 0 for m in labelling.label_maps))
    trained = train(capture, nothing, quick(label_mode=mode), silent)
    if trained.evidence is None:
        assert not (trained.gaussians.codes @ trained.head.weight.T + trained.head.bias).argmax(axis=1).any()
    else:
        assert len(trained.evidence.counts) == 0


@pytest.mark.parametrize("mode", ["codes", "evidence"])
@pytest.mark.parametrize("labels", [1, 10_000])
def test_one_label_and_ten_thousand_can_be_trained(
    world: World, quick: Callable[..., TrainingSettings], mode: str, labels: int
) -> None:
    capture, labelling = world
    names = dictionary_of(f"object {number}x" for number in range(labels))
    ids = np.array([0, 1, 1, 1] if labels == 1 else [0, 1, 5_000, 10_000], np.uint16)
    maps = tuple(ids[label_map] for label_map in labelling.label_maps)
    settings = quick(label_mode=mode, iterations=5, start_scale=1.0)
    trained = train(capture, Labelling(names, maps), settings, silent)
    if trained.evidence is None:
        assert trained.head.weight.shape == (labels + 1, 1 if labels == 1 else 13)
        classes = np.unique((trained.gaussians.codes @ trained.head.weight.T + trained.head.bias).argmax(axis=1))
    else:
        classes = np.unique(posterior(trained.evidence, labels + 1).classes)
    assert len(classes) > 1 or labels == 1
    assert set(classes.tolist()) <= set(ids.tolist())


def test_a_view_nobody_looked_at_says_nothing(world: World) -> None:
    capture, labelling = world
    maps = (labelling.label_maps[0] * 0, *labelling.label_maps[1:])
    views = drop_empty_label_maps(load_views(capture, Labelling(labelling.dictionary, maps), (0, 1), 640, (0.5, 1.0)))
    assert [[frame.labels is None for frame in view.frames] for view in views] == [[True, True], [False, False]]


def test_in_exact_maps_a_pixel_without_a_label_is_as_sure_as_any(
    world: World, quick: Callable[..., TrainingSettings]
) -> None:
    capture, labelling = world
    settings = quick(label_mode="evidence")
    seen = []
    for exact in (False, True):
        trained = train(capture, dataclasses.replace(labelling, exact=exact), settings, silent)
        assert trained.evidence is not None
        seen.append(trained.evidence.counts[trained.evidence.labels == 0].sum())
    assert seen[1] == pytest.approx(10 * seen[0], rel=1e-2)


def test_maps_that_do_not_fit_are_refused(trained: TrainedSplats, world: World) -> None:
    posed = world[0].views[0].posed
    for labels, valid in (
        (np.zeros((3, 3), int), None),
        (np.full((48, 64), CLASSES), None),
        (np.zeros((48, 64), int), np.ones((3, 3), bool)),
    ):
        with pytest.raises(InvalidInputError):
            view_evidence(trained.gaussians, posed, labels, CLASSES, valid=valid)
