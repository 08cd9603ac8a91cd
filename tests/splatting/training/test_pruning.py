"""Laws of pruning: what is pruned was not needed, and never costs more than allowed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.splatting.training.pruning import max_contribution, prune_to_psnr
from fastsplat.service.splatting.training_views import load_views
from fastsplat_contract.geometry.camera import Camera
from tests.scenes import labelled_scene


def _gaussians(count: int, degree: int = 1) -> Gaussians:
    random = np.random.default_rng(0)
    means, sh = random.normal(size=(count, 3)), random.normal(size=(count, (degree + 1) ** 2, 3))
    return labelled_scene(means, np.zeros(count, int), (), scales=0.05, logit_opacities=0.0, sh=sh).gaussians


@given(st.floats(0.001, 3), st.floats(0, 5), st.integers(0, 300), st.integers(0, 3), st.integers(0, 10**6))
def test_no_more_is_lost_than_allowed(allowed, harmonics_db, count, degree, seed) -> None:
    scene = _gaussians(count, degree)
    weight = np.random.default_rng(seed).exponential(size=count)

    def quality(some: Gaussians) -> float:
        return 30 + harmonics_db * some.sh_degree + 5 * len(some) / max(count, 1)

    left = prune_to_psnr(scene, weight, quality, allowed)
    assert quality(scene) - quality(left) <= allowed + 1e-9
    stays = np.isin(scene.means[:, 0], left.means[:, 0])
    assert (left.means == scene.means[stays]).all()
    assert (left.sh == scene.sh[stays, : left.sh.shape[1]]).all()
    assert stays.all() or not stays.any() or weight[~stays].max() <= weight[stays].min()


def test_nothing_is_taken_when_nothing_may_be_lost() -> None:
    scene = _gaussians(50)
    left = prune_to_psnr(scene, np.ones(50), lambda some: 20.0, 0.0)
    assert left is scene


def test_harmonics_that_gain_nothing_go_and_those_that_gain_stay() -> None:
    scene = _gaussians(64, degree=2)
    flat = prune_to_psnr(scene, np.ones(64), lambda some: 20.0 + 100 * (len(some) == 64), 0.05)
    assert flat.sh_degree == 0 and len(flat) == 64
    result = prune_to_psnr(scene, np.ones(64), lambda some: 20.0 + min(some.sh_degree, 1) + len(some), 0.05)
    assert result.sh_degree == 1 and len(result) == 64


def test_all_that_is_worth_nothing_goes_to_a_64th() -> None:
    scene = _gaussians(640)
    left = prune_to_psnr(scene, np.arange(640.0), lambda some: 20.0, 0.1)
    assert (left.means == scene.means[630:]).all()


def test_what_no_view_shows_contributes_nothing(world) -> None:
    capture, labelling = world
    views = load_views(capture, labelling, (0, 4, 8), 640, (0.5, 1.0))
    scene = _gaussians(3)
    scene.means[:] = [[0, 0, 0.2], [0, 0, 500.0], [0, 0, 0.2]]
    scene.logit_opacities[:] = [3, 3, -20]
    cameras = [(view.viewmat, view.frames[0].camera) for view in views]
    weight = max_contribution(scene, cameras)
    assert weight[0] > 1 and weight[1] == 0 == weight[2]
    assert isinstance(views[0].frames[0].camera, Camera)
    assert weight == pytest.approx(np.max([max_contribution(scene, [camera]) for camera in cameras], axis=0))
