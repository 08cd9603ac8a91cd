"""Several cameras in one call: each picture as of a call of its own, gradients their sum."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch
from raster_scenes import NAMES, View, crowded, relative

from fastsplat.service.splatting.raster import Rendering, Splats, rasterize, rasterize_batch
from fastsplat.service.splatting.raster.types import Backend
from fastsplat_contract.camera import Camera
from fastsplat_contract.errors import InvalidInputError


@pytest.fixture(params=["reference", "cpu", "cuda"])
def backend(request: pytest.FixtureRequest) -> Backend:
    if request.param == "cuda":
        request.getfixturevalue("gsplat_on_cpu")
    return request.param


def poses(view: View, count: int) -> torch.Tensor:
    viewmats = view.viewmat.repeat(count, 1, 1)
    viewmats[:, 0, 3] += 0.3 * torch.arange(count)
    return viewmats


def scalar(view: View, outputs: tuple[Rendering, ...]) -> torch.Tensor:
    total = torch.zeros((), dtype=torch.float64)
    for weight, out in enumerate(outputs, 1):
        height, width = out.alpha.shape
        total = total + weight * (out.image * view.grad_image[:height, :width]).double().sum()
        total = total + (out.alpha * view.grad_alpha[:height, :width]).double().sum()
        total = total + (out.depth * view.grad_depth[:height, :width]).double().sum()
    return total


@pytest.mark.parametrize("sizes", ["one size", "two sizes"])
@pytest.mark.parametrize("per_view", [False, True])
def test_a_batch_is_its_views_and_its_gradients_are_their_sum(backend: Backend, sizes: str, per_view: bool) -> None:
    view = crowded(0)
    view = view.with_splats(opacities=view.splats.opacities.clamp(max=0.95))
    cameras = [view.camera] * 3
    if sizes == "two sizes":
        cameras[1] = Camera(21, 18, 30.0, 32.0, 10.0, 9.0)
    features = view.splats.features
    if per_view:
        features = torch.stack([features, 0.5 * features, features.flip(0)])
    results: list[Any] = []
    for together in (True, False):
        parts = {name: getattr(view.splats, name).clone().requires_grad_() for name in NAMES}
        parts["features"] = features.clone().requires_grad_()
        background = view.background.clone().requires_grad_()
        splats, viewmats = Splats(**parts), poses(view, 3)
        if together:
            out = rasterize_batch(splats, viewmats, cameras, background=background, backend=backend)
        else:
            each = parts["features"] if per_view else [parts["features"]] * 3
            out = tuple(
                rasterize(replace(splats, features=own), pose, camera, background=background, backend=backend)
                for own, pose, camera in zip(each, viewmats, cameras, strict=True)
            )
        scalar(view, out).backward()
        results.append((out, [part.grad for part in (*parts.values(), background)]))
    (ours, gradients), (singles, wanted) = results
    for one, other in zip(ours, singles, strict=True):
        assert torch.equal(one.radii, other.radii) and one.culled_non_finite == other.culled_non_finite
        for name in ("image", "alpha", "depth"):
            assert relative(getattr(one, name), getattr(other, name)) < 1e-6, name
    for one, other in zip(gradients, wanted, strict=True):
        assert relative(one, other) < 1e-5


def test_a_broken_row_of_one_view_is_missing_there_and_nowhere_else(backend: Backend) -> None:
    view = crowded(1)
    features = view.splats.features.repeat(2, 1, 1)
    features[1, 7, 2] = float("nan")
    means = view.splats.means.clone()
    means[20, 0] = float("inf")
    splats = replace(view.splats, means=means, features=features)
    first, second = rasterize_batch(splats, poses(view, 2), [view.camera] * 2, backend=backend)
    assert (first.culled_non_finite, second.culled_non_finite) == (1, 2)
    assert bool(torch.isfinite(first.image).all()) and bool(torch.isfinite(second.image).all())
    assert int(second.radii[7]) == 0 and int(second.radii[20]) == 0


def test_no_gaussians_and_no_views(backend: Backend) -> None:
    view = crowded(2, count=0)
    (out,) = rasterize_batch(view.splats, poses(view, 1), [view.camera], background=view.background, backend=backend)
    assert torch.allclose(out.image, view.background.expand_as(out.image)) and float(out.alpha.abs().sum()) == 0.0
    assert rasterize_batch(view.splats, torch.zeros(0, 4, 4), [], backend=backend) == ()


def test_views_of_one_size_go_to_the_gpu_in_one_call(gsplat_on_cpu: Any) -> None:
    view = crowded(3)
    rasterize_batch(view.splats, poses(view, 4), [view.camera] * 4, backend="cuda")
    assert gsplat_on_cpu.calls == 1


def test_what_does_not_fit_is_refused() -> None:
    view = crowded(0)
    with pytest.raises(InvalidInputError):
        rasterize_batch(view.splats, poses(view, 3), [view.camera] * 2)
    with pytest.raises(InvalidInputError):
        rasterize_batch(replace(view.splats, features=torch.zeros(3, 60, 2)), poses(view, 2), [view.camera] * 2)
    with pytest.raises(InvalidInputError):
        rasterize_batch(view.splats, poses(view, 1) * float("nan"), [view.camera])
