"""Laws of the terms that make depth measurable, and what they do to a run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from fastsplat.service.splatting.raster.image_formation import Rendering
from fastsplat.service.splatting.training.depth_regularization import (
    AnchorPoints,
    DepthAnchors,
    anchor_error,
    depth_anchors,
    depth_roughness,
    depth_spread,
    depth_terms,
    surface_loss,
)
from fastsplat.service.splatting.training.schedule import depth_regularized
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat.service.splatting.training_views import load_views, squared_depths
from tests.splatting.training.conftest import assert_gradients_agree


def _blend(weights: Tensor, depths: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """alpha, depth and squared depth [1, 1] of a pixel that blends these."""
    return tuple((weights * depths**power).sum().reshape(1, 1) for power in (0, 1, 2))


def test_spread_is_that_of_all_pairs_and_none_where_all_lie_at_one_depth() -> None:
    weights, depths = torch.tensor([0.2, 0.5, 0.1]), torch.tensor([1.0, 2.0, 4.0])
    alpha, depth, squared = _blend(weights, depths)
    pairs = 0.5 * (weights[:, None] * weights * (depths[:, None] - depths) ** 2).sum()
    expected = pairs / (depth / alpha)[0, 0] ** 2
    assert torch.allclose(depth_spread(alpha, depth, squared), expected, rtol=1e-5)
    assert depth_spread(*_blend(weights, torch.full((3,), 3.0))) < 1e-6
    assert depth_spread(*(torch.zeros(2, 2),) * 3) == 0


def test_spread_and_smoothness_do_not_depend_on_the_unit_of_length() -> None:
    random = torch.Generator().manual_seed(0)
    weights, depths = torch.rand(3, 9, 9, generator=random) / 3, 1 + torch.rand(3, 9, 9, generator=random)
    alpha, target = weights.sum(0), torch.zeros(9, 9, 3)
    for unit in (1e-3, 1e3):
        base, scaled = (((weights * d).sum(0), (weights * d * d).sum(0)) for d in (depths, unit * depths))
        assert torch.allclose(depth_spread(alpha, *base), depth_spread(alpha, *scaled), rtol=1e-3)
        assert torch.allclose(
            depth_roughness(alpha, base[0], target), depth_roughness(alpha, scaled[0], target), rtol=1e-3
        )


def _plane(height: int = 24, width: int = 32) -> Tensor:
    """Depth of a slanted plane."""
    y, x = torch.meshgrid(torch.arange(height) / 24.0, torch.arange(width) / 24.0, indexing="ij")
    return 1 / (0.3 + 0.2 * x - 0.1 * y)


def test_a_plane_is_smooth_and_a_bent_surface_is_not_unless_the_photo_has_an_edge_there() -> None:
    alpha, plain = torch.ones(24, 32), torch.full((24, 32, 3), 0.5)
    bent = 1 / (1 / _plane() + 0.02 * torch.relu(torch.arange(32) - 16.0))
    assert depth_roughness(alpha, _plane(), plain) < 1e-6
    roughness = depth_roughness(alpha, bent, plain)
    assert roughness > 1e-4
    edge = plain.clone()
    edge[:, 16:] = 0.0
    assert depth_roughness(alpha, bent, edge) < 0.2 * roughness


def test_what_is_not_valid_makes_nothing_rough() -> None:
    alpha, plain, valid = torch.ones(24, 32), torch.full((24, 32, 3), 0.5), torch.ones(24, 32, dtype=torch.bool)
    hole = _plane()
    hole[8:12, 8:12] = 5.0
    valid[8:12, 8:12] = False
    assert depth_roughness(alpha, hole, plain) > 1e-3
    assert depth_roughness(alpha, hole, plain, valid) < 1e-6


def test_an_anchor_pulls_a_surface_near_it_and_leaves_what_hides_it_alone() -> None:
    anchors = DepthAnchors(torch.tensor([0, 0]), torch.tensor([0, 1]), torch.tensor([2.0, 2.0]))
    depth = torch.tensor([[2.2, 1.0]], requires_grad=True)
    error = anchor_error(torch.ones(1, 2), depth, anchors)
    assert torch.allclose(error, torch.tensor(0.05))  # 0.1 of one of two
    error.backward()
    assert depth.grad is not None and depth.grad[0, 0] > 0 and depth.grad[0, 1] == 0
    nothing = DepthAnchors(torch.zeros(0, dtype=torch.int64), torch.zeros(0, dtype=torch.int64), torch.zeros(0))
    assert anchor_error(torch.ones(1, 2), depth, nothing) == 0


def test_anchors_are_the_points_in_view_whose_pixel_has_their_color(world) -> None:
    capture, labelling = world
    view = load_views(capture, labelling, (0,), 64, (1.0,))[0]
    frame = view.frames[-1]
    points = torch.from_numpy(capture.points)
    colors = torch.from_numpy(capture.point_colors.astype(np.float32) / 255)
    anchors = depth_anchors(AnchorPoints(points, colors), view, frame)
    assert 0 < len(anchors.depths) < len(points)
    assert (anchors.depths > 0).all()
    assert not len(depth_anchors(AnchorPoints(points, colors + 2), view, frame).depths)
    behind = torch.from_numpy(capture.views[0].posed.world_from_camera[:3, 3].astype(np.float32)) * 3
    assert not len(depth_anchors(AnchorPoints(behind[None], colors[:1]), view, frame).depths)
    masked = replace(frame, valid=torch.zeros(frame.rgb.shape[:2], dtype=torch.bool))
    assert not len(depth_anchors(AnchorPoints(points, colors), view, masked).depths)


@pytest.mark.parametrize("backend", ["cpu", "cuda"])
def test_gradients_of_all_terms_agree_with_the_reference_in_float64(backend: str, gsplat_on_cpu: object) -> None:
    anchors = DepthAnchors(torch.tensor([4, 9, 15]), torch.tensor([6, 12, 20]), torch.tensor([2.4, 2.6, 2.5]))
    target = torch.rand(20, 24, 3, generator=torch.Generator().manual_seed(3))

    def loss(out: Rendering) -> Tensor:
        exact = replace(anchors, depths=anchors.depths.to(out.depth.dtype))
        surface = surface_loss(out.alpha, out.depth, out.image[..., 0], target.to(out.depth.dtype), None, 1.0, 1.0)
        return surface + anchor_error(out.alpha, out.depth, exact)

    assert_gradients_agree(backend, 3, squared_depths, loss)


def test_the_terms_enter_between_the_steps_of_the_labels(quick) -> None:
    settings = quick(depth_from=0.5)
    assert [depth_regularized(i, 0.6, settings) for i in range(4)] == [False, True, False, True]
    assert not depth_regularized(1, 0.4, settings)
    off = quick(depth_spread_weight=0, depth_smoothness_weight=0, depth_anchor_weight=0)
    assert not depth_regularized(1, 1.0, off)


def test_each_term_has_its_weight_times_how_seldom_it_enters_and_none_is_off_by_default() -> None:
    random = torch.Generator().manual_seed(5)
    alpha, depth, squared = (torch.rand(24, 32, generator=random) + start for start in (0.5, 2.0, 9.0))
    rendering = Rendering(torch.zeros(24, 32, 3), alpha, depth, None, torch.zeros(1, dtype=torch.int32), 0)
    target = torch.rand(24, 32, 3, generator=random)
    anchors = DepthAnchors(torch.tensor([4, 9]), torch.tensor([6, 12]), torch.tensor([2.4, 2.6]))

    def terms(settings: TrainingSettings) -> dict[str, Tensor]:
        return depth_terms(rendering, squared, anchors, target, None, settings)

    spread, roughness = depth_spread(alpha, depth, squared), depth_roughness(alpha, depth, target)
    error = anchor_error(alpha, depth, anchors)
    assert all(value > 0 for value in (spread, roughness, error))
    assert terms(TrainingSettings()).keys() == {"depth_surface", "depth_anchors"}
    weighted = terms(
        TrainingSettings(depth_spread_weight=2, depth_smoothness_weight=3, depth_anchor_weight=5, depth_every=7)
    )
    assert torch.allclose(weighted["depth_surface"], 7 * (2 * spread + 3 * roughness))
    assert torch.allclose(weighted["depth_anchors"], 7 * 5 * error)
