"""Planned runs of the smallest scenes train to the end."""

from __future__ import annotations

import dataclasses

import pytest

from fastsplat.service.common.progress import silent
from fastsplat.service.planning.cost_model import SceneSize, fit_training, scene_size
from fastsplat.service.splatting.training.train import train
from fastsplat.service.splatting.training_settings import TrainingSettings


def test_the_size_of_a_capture_is_that_of_its_largest_image(world) -> None:
    capture, labelling = world
    assert scene_size(capture, len(labelling.dictionary)) == SceneSize(12, 64, 48, len(capture.points), 0)
    given = dataclasses.replace(capture, given_labels=capture.views[0].image_path.parent)
    assert scene_size(given, len(labelling.dictionary)).labels == 3, "codes learn what came with the capture alone"
    assert scene_size(dataclasses.replace(capture, views=()), 0).width == 0


@pytest.mark.parametrize(("views", "gaussians"), [(1, 1), (1, 300), (12, 1)])
def test_the_smallest_plans_train_to_a_whole_scene(make_world, views: int, gaussians: int) -> None:
    capture, labelling = make_world(views)
    requested = TrainingSettings(max_gaussians=gaussians, tolerance_db=0.05)
    planned = fit_training(requested, scene_size(capture, 3), 1.0)
    trained = train(capture, labelling, planned.settings.model_copy(update={"iterations": 30}), silent)
    assert 1 <= len(trained.gaussians) <= gaussians and trained.quality["iterations"] <= 30
