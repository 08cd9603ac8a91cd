"""Laws of the term for what a depth sensor measured, and what it does to a run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from fastsplat.service.capture.formats.depth_maps import load_depth, resample_depth, save_depth
from fastsplat.service.common.progress import silent
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.rendering import rasterize
from fastsplat.service.splatting.training.objective import sensor_depth_error
from fastsplat.service.splatting.training.schedule import depth_regularized
from fastsplat.service.splatting.training.train import train
from fastsplat.service.splatting.training_views import load_views
from fastsplat_contract.geometry.camera import Camera
from tests.splatting.training.conftest import assert_gradients_agree


def test_the_error_is_the_mean_logarithm_over_measured_valid_covered_pixels() -> None:
    alpha = torch.tensor([[1.0, 0.5, 1.0, 0.0, 1.0]])
    depth = torch.tensor([[2.0, 1.1, 7.0, 0.0, 7.0]])
    measured = torch.tensor([[2.0, 2.0, 0.0, 2.0, 3.0]])
    valid = torch.tensor([[True, True, True, True, False]])
    error = sensor_depth_error(alpha, depth, measured, valid)
    assert torch.allclose(error, torch.log(torch.tensor(1.1)) / 2)  # the third unmeasured, the fourth bare
    assert sensor_depth_error(alpha, depth, torch.zeros(1, 5)) == 0


def test_gradients_are_finite_where_nothing_counts() -> None:
    alpha = torch.zeros(2, 2, requires_grad=True)
    depth = torch.zeros(2, 2, requires_grad=True)
    sensor_depth_error(alpha, depth, torch.tensor([[0.0, 1.0], [2.0, 0.0]])).backward()
    assert alpha.grad is not None and depth.grad is not None
    assert not alpha.grad.any() and not depth.grad.any()


@pytest.mark.parametrize("backend", ["cpu", "cuda"])
def test_gradients_agree_with_the_reference_in_float64(backend: str, gsplat_on_cpu: object) -> None:
    random = torch.Generator().manual_seed(5)
    measured = 2.0 + torch.rand(20, 24, generator=random)
    measured[torch.rand(20, 24, generator=random) < 0.3] = 0.0
    assert_gradients_agree(
        backend,
        4,
        lambda means, pose: torch.ones_like(means[:, :1]),
        lambda out: sensor_depth_error(out.alpha, out.depth, measured.to(out.depth.dtype)),
    )


def test_maps_are_resampled_without_mixing_two_surfaces() -> None:
    fine = Camera(8, 6, 8.0, 8.0, 4.0, 3.0)
    depth = np.where(np.arange(8) < 4, 1.0, 5.0).astype(np.float32)[None].repeat(6, 0)
    coarse = resample_depth(depth, fine, fine.scaled_to(4, 3))
    assert coarse.shape == (3, 4) and set(np.unique(coarse)) == {1.0, 5.0}
    assert (coarse[:, :2] == 1).all() and (coarse[:, 2:] == 5).all()
    larger = resample_depth(depth, fine, fine.scaled_to(24, 18))
    assert (larger > 0).sum() == 48 and set(np.unique(larger)) == {0.0, 1.0, 5.0}
    assert larger[1, 1] == 1 and larger[1, 22] == 5  # where the measurements' centers lie
    assert not resample_depth(depth, fine, Camera(8, 6, 8.0, 8.0, 400.0, 3.0)).any()
    np.testing.assert_array_equal(resample_depth(depth, fine, fine), depth)


def test_the_term_enters_only_where_something_was_measured(quick) -> None:
    settings = quick(depth_spread_weight=0, depth_smoothness_weight=0, depth_anchor_weight=0)
    assert depth_regularized(1, 1.0, settings, measured=True) and not depth_regularized(1, 1.0, settings)
    assert not depth_regularized(1, 1.0, settings.model_copy(update={"sensor_depth_weight": 0}), measured=True)


def test_a_run_ends_nearer_to_what_was_measured(world, quick, tmp_path) -> None:
    """The sensor says of every pixel that it is as far as the middle of the world."""
    capture, labelling = world
    far = float(np.linalg.norm(capture.views[0].posed.world_from_camera[:3, 3]))
    views = []
    for index, view in enumerate(capture.views):
        camera = view.posed.camera.scaled_to(32, 24)
        sensor = save_depth(np.full((24, 32), far, np.float32), camera, tmp_path / f"{index}.png")
        np.testing.assert_allclose(load_depth(sensor), far, rtol=1e-4)
        views.append(replace(view, depth=sensor))
    measured = replace(capture, views=tuple(views))

    def error(weight: float) -> float:
        trained = train(measured, labelling, quick(iterations=80, sensor_depth_weight=weight), silent)
        view = load_views(measured, labelling, (0,), 64, (1.0,))[0]
        frame = view.frames[-1]
        assert frame.depth is not None and 0 < (frame.depth > 0).float().mean() <= 0.26
        splats = splats_of(trained.gaussians)
        out = rasterize(replace(splats, features=torch.ones(len(splats.means), 1)), view.viewmat, frame.camera)
        return float(sensor_depth_error(out.alpha, out.depth, frame.depth))

    assert error(3.0) < 0.6 * error(0.0)
