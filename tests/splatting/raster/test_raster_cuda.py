"""The GPU backend: parity with `cpu` where there is a GPU, and a typed refusal where there is none."""

from __future__ import annotations

import importlib.util
from dataclasses import replace

import pytest
import torch
from raster_scenes import NAMES, View, crowded, relative, render, render_with_gradients

from fastsplat.service.splatting.raster.rendering import accumulate_weights, rasterize
from fastsplat.service.splatting.raster.types import RasterSettings, Splats
from fastsplat_contract.errors import InvalidInputError, ModelUnavailableError

needs_gpu = pytest.mark.skipif(
    not torch.cuda.is_available() or importlib.util.find_spec("gsplat") is None, reason="no NVIDIA GPU"
)


def moderate() -> View:
    """Opacities below gsplat's and our alpha clamp, so that both draw the same."""
    view = crowded(0)
    return view.with_splats(opacities=view.splats.opacities.clamp(max=0.95))


def test_without_a_gpu_the_error_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    view = moderate()
    with pytest.raises(ModelUnavailableError, match="GPU"):
        render(view, "cuda")
    with pytest.raises(ModelUnavailableError, match="GPU"):
        accumulate_weights(view.splats, view.viewmat, view.camera, torch.ones(29, 37, 1), backend="cuda")


@needs_gpu
def test_parity_with_cpu() -> None:
    view = moderate()
    results = []
    for backend, device in (("cpu", "cpu"), ("cuda", "cuda")):
        parts = {name: getattr(view.splats, name).to(device, copy=True).requires_grad_() for name in NAMES}
        out = rasterize(
            Splats(**parts), view.viewmat, view.camera, background=view.background.to(device), backend=backend
        )
        scalar = (out.image * view.grad_image.to(device)).sum() + (out.depth * view.grad_depth.to(device)).sum()
        (scalar + (out.alpha * view.grad_alpha.to(device)).sum()).backward()
        values = [out.image.detach().cpu(), out.depth.detach().cpu()]
        results.append(values + [part.grad.cpu() for part in parts.values() if part.grad is not None])
    for ours, theirs in zip(*results, strict=True):
        assert relative(theirs, ours) < 1e-3
    on_gpu = Splats(**{name: getattr(view.splats, name).cuda() for name in NAMES})
    values = torch.rand(29, 37, 3)
    sums = accumulate_weights(on_gpu, view.viewmat, view.camera, values.cuda(), backend="cuda").cpu()
    assert relative(sums, accumulate_weights(view.splats, view.viewmat, view.camera, values)) < 1e-3


@needs_gpu
def test_cut_offs_that_gsplat_fixes_are_refused() -> None:
    view = moderate()
    splats = Splats(**{name: getattr(view.splats, name).cuda() for name in NAMES})
    with pytest.raises(InvalidInputError):
        rasterize(splats, view.viewmat, view.camera, settings=replace(RasterSettings(), alpha_min=0.1), backend="cuda")


def test_the_adapter_hands_on_image_depth_and_gradients(gsplat_on_cpu: object) -> None:
    view = moderate()
    ours, gradients = render_with_gradients(view, "cuda", torch.float32)
    truth, expected = render_with_gradients(view, "reference", torch.float64)
    for name in ("image", "alpha", "depth"):
        assert relative(getattr(ours, name), getattr(truth, name)) < 1e-5, name
    assert torch.equal(ours.radii, truth.radii)
    for name, gradient in gradients.items():
        assert relative(gradient, expected[name]) < 1e-4, name


def test_what_gsplat_does_not_report_is_none_and_no_nan(gsplat_on_cpu: object) -> None:
    for view in (moderate(), crowded(0, count=0)):
        rendering = render(view, "cuda")
        assert rendering.median_depth is None
        assert all(bool(torch.isfinite(getattr(rendering, name)).all()) for name in ("image", "alpha", "depth"))


def test_broken_rows_are_left_out_before_gsplat_sees_them(gsplat_on_cpu: object) -> None:
    view = moderate()
    features, means = view.splats.features.clone(), view.splats.means.clone()
    features[7, 2], means[20, 0] = float("nan"), float("inf")
    rendering = render(view.with_splats(features=features, means=means), "cuda")
    assert rendering.culled_non_finite == 2 and bool(torch.isfinite(rendering.image).all())
    assert int(rendering.radii[7]) == 0 and int(rendering.radii[20]) == 0


def test_no_gaussians_leave_the_background_and_gradients_of_zero(gsplat_on_cpu: object) -> None:
    view = crowded(2, count=0)
    rendering, gradients = render_with_gradients(view, "cuda", torch.float32)
    assert torch.equal(rendering.image, view.background.expand_as(rendering.image))
    assert float(rendering.alpha.abs().sum()) == 0.0 and gradients["means"].shape == (0, 3)
