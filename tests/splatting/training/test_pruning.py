"""Laws of what a scene requires: surplus goes, never more than allowed; little to show takes little."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from torch import Tensor

from fastsplat.service.common.progress import silent
from fastsplat.service.splatting.state import new_state
from fastsplat.service.splatting.training.pruning import max_contribution, required_degree, required_rows
from fastsplat.service.splatting.training.requirement import Requirement
from fastsplat.service.splatting.training.train import train
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat.service.splatting.training_views import load_views
from fastsplat_contract.errors import CancelledError
from tests.splatting.training.conftest import drawn_parameters, same_run, stopping_at


@given(st.floats(0.001, 3), st.floats(0, 5), st.integers(1, 300), st.integers(0, 3), st.integers(0, 10**6))
def test_no_more_is_lost_than_allowed(allowed, harmonics_db, count, degree, seed) -> None:
    scene = drawn_parameters(count, degree)
    weight = np.random.default_rng(seed).exponential(size=count)

    def quality(some: Mapping[str, Tensor]) -> float:
        return 30 + harmonics_db * some["sh_rest"].shape[1] + 5 * len(some["means"]) / count

    rows = required_rows(scene, weight, quality, quality(scene) - allowed).numpy()
    assert 5 * (1 - len(rows) / count) <= allowed + 1e-9
    stays = np.isin(np.arange(count), rows)
    assert (np.diff(rows) > 0).all() and (stays.all() or not stays.any() or weight[~stays].max() <= weight[stays].min())
    lowest = required_degree(scene, quality, quality(scene) - allowed)
    assert harmonics_db * ((degree + 1) ** 2 - (lowest + 1) ** 2) <= allowed + 1e-9
    assert lowest == 0 or harmonics_db * ((degree + 1) ** 2 - lowest**2) > allowed - 1e-9


def test_all_that_is_worth_nothing_goes_to_a_64th() -> None:
    rows = required_rows(drawn_parameters(640), np.arange(640.0), lambda some: 20.0, 19.9)
    assert rows.tolist() == list(range(630, 640))


def test_what_no_view_shows_contributes_nothing(world) -> None:
    capture, labelling = world
    views = load_views(capture, labelling, (0, 4, 8), 640, (0.5, 1.0))
    scene = drawn_parameters(3)
    scene["means"] = torch.tensor([[0, 0, 0.2], [0, 0, 500.0], [0, 0, 0.2]])
    scene["logit_opacities"] = torch.tensor([3.0, 3, -20])
    cameras = [(view.viewmat, view.frames[0].camera) for view in views]
    weight = max_contribution(scene, cameras)
    assert weight[0] > 1 and weight[1] == 0 == weight[2]
    assert weight == pytest.approx(np.max([max_contribution(scene, [camera]) for camera in cameras], axis=0))


_BUDGET = TrainingSettings(iterations=10_000, time_budget_s=None, evaluations=0)


@pytest.mark.parametrize(("shade", "most"), [(0, 0), (128, 800)])
def test_pictures_of_one_color_take_next_to_nothing(make_world, shade: int, most: int) -> None:
    capture, labelling = make_world()
    for view in capture.views:
        Image.new("RGB", (64, 48), (shade,) * 3).save(view.image_path)
    trained = train(capture, labelling, _BUDGET, silent)
    assert len(trained.gaussians) <= most and trained.quality["iterations"] < 1_500 and trained.quality["enough"]


def test_a_run_that_was_taken_back_to_more_is_pruned_again(world, quick) -> None:
    views, parameters = load_views(*world, (0, 4, 8), 640, (1.0,)), drawn_parameters(60, degree=0)
    state = new_state(parameters)
    state.iteration = 251
    requirement = Requirement(quick(tolerance_db=6.0), views, (), state)
    for _ in range(2):
        requirement.after_step(0.9)
        assert state.count == requirement.budget == Requirement(quick(), views, (), state).budget < 60
        for name, value in parameters.items():
            state.begin(name, value)


def test_a_run_that_needs_no_more_ends_alike_after_a_checkpoint(world, quick, tmp_path: Path) -> None:
    """It is pruned, and ends when the last half of its steps gained less than the tolerance."""
    settings = quick(iterations=3_900, max_gaussians=600, tolerance_db=18.0, checkpoint_every_s=0)
    whole = train(*world, settings, silent)
    assert whole.quality["iterations"] < 3_900 and whole.quality["next_doubling_db"] < 3
    assert len(whole.gaussians) < 500

    with pytest.raises(CancelledError):
        train(*world, settings, stopping_at(1_100), tmp_path)
    assert same_run(train(*world, settings, silent, tmp_path), whole)
