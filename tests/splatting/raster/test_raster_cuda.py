"""The GPU backend: parity with `cpu` where there is a GPU, and a typed refusal where there is none."""

from __future__ import annotations

import sys
import types
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from raster_scenes import NAMES, View, crowded, relative, render, render_with_gradients, scalar_of
from torch import Tensor

from fastsplat.service.jobs.create_scene import build_views
from fastsplat.service.settings import load_settings
from fastsplat.service.splatting.raster import cuda, median_depth
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import RasterSettings, Splats
from fastsplat.service.splatting.raster.rendering import accumulate_weights, rasterize
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat_contract.errors import InvalidInputError, ModelUnavailableError
from tests.splatting.gsplat_front_end import needs_gpu


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


@pytest.mark.parametrize("how", ["no toolkit", "the build fails", "the build breaks off"])
def test_kernels_that_could_not_be_built_are_said_before_anything_is_drawn(
    monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    if how == "no toolkit":  # what gsplat leaves behind where it finds no nvcc
        backend = types.ModuleType("gsplat.cuda._backend")
        backend._C = None  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "gsplat.cuda._backend", backend)
    else:
        error = RuntimeError("Error building extension") if how == "the build fails" else OSError("disk full")
        monkeypatch.setitem(sys.modules, "gsplat.cuda._backend", None)
        monkeypatch.delitem(sys.modules, "gsplat.cuda._backend")
        monkeypatch.setattr(sys, "meta_path", [_Failing(error), *sys.meta_path])
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    cuda._has_kernels.cache_clear()
    try:
        with pytest.raises(ModelUnavailableError, match="kernels") as caught:
            device_of("cuda")
        assert caught.value.field == "backend" and "nvcc" in caught.value.hint
        settings = load_settings().model_copy(update={"training": TrainingSettings(backend="cuda")})
        with pytest.raises(ModelUnavailableError, match="kernels"):
            build_views(Path("no upload is looked at"), Path("nor written to"), settings)
    finally:
        cuda._has_kernels.cache_clear()


class _Failing:
    """An import of gsplat's kernels that ends as their build does."""

    def __init__(self, error: Exception) -> None:
        self._error = error

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        if name == "gsplat.cuda._backend":
            raise self._error


@needs_gpu
def test_parity_with_cpu() -> None:
    view = moderate()
    results = []
    for backend, device in (("cpu", "cpu"), ("cuda", "cuda")):
        parts = {name: getattr(view.splats, name).to(device, copy=True).requires_grad_() for name in NAMES}
        out = rasterize(
            Splats(**parts), view.viewmat, view.camera, background=view.background.to(device), backend=backend
        )
        scalar_of(view, out).backward()
        values = [out.image.detach().cpu(), out.depth.detach().cpu()]
        results.append(values + [part.grad.cpu() for part in parts.values() if part.grad is not None])
    for ours, theirs in zip(*results, strict=True):
        assert relative(theirs, ours) < 1e-3
    on_gpu = Splats(**{name: getattr(view.splats, name).cuda() for name in NAMES})
    for scene_view in (view, deep()):
        with torch.no_grad():
            there = scene_view.with_splats(**{name: getattr(scene_view.splats, name).cuda() for name in NAMES})
            found = render(replace(there, background=scene_view.background.cuda()), "cuda").median_depth
            truth = render(scene_view, "cpu").median_depth
        assert_the_same_median(found.cpu(), truth)
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
    assert torch.equal(ours.radii > 0, truth.radii > 0)  # how far each reaches is rounded in another way
    for name, gradient in gradients.items():
        assert relative(gradient, expected[name]) < 1e-4, name


def deep(count: int = 400) -> View:
    """More Gaussians on a pixel than are looked at together, of which no few take half of the light."""
    view = crowded(3, count=count)
    return view.with_splats(opacities=0.02 + 0.1 * view.splats.opacities, scales=view.splats.scales.clamp(max=0.5))


def assert_the_same_median(ours: Tensor, truth: Tensor) -> None:
    """But for pixels where one half is lost by so little that rounding decides whose depth it is."""
    same = (ours.double() - truth.double()).abs() <= 1e-4 * truth.double()
    assert float(same.double().mean()) > 0.995 and float((truth > 0).double().mean()) > 0.3


@pytest.mark.parametrize("view", [moderate(), deep()], ids=["moderate", "deep"])
def test_the_median_depth_is_that_of_the_reference(
    gsplat_on_cpu: object, monkeypatch: pytest.MonkeyPatch, view: View
) -> None:
    with torch.no_grad():
        truth = render(view, "reference", torch.float64).median_depth
        for most in (2**24, 1):  # all tiles at once, and one by one
            monkeypatch.setattr(median_depth, "_MOST_VALUES", most)
            ours = render(view, "cuda").median_depth
            assert_the_same_median(ours, truth)


def test_where_gradients_are_taken_there_is_no_median_depth_and_of_nothing_all_is_finite(gsplat_on_cpu: object) -> None:
    for view in (moderate(), crowded(0, count=0)):
        rendering = render(view, "cuda")
        assert rendering.median_depth is None
        with torch.no_grad():
            alone = render(view, "cuda")
        for name in ("image", "alpha", "depth", "median_depth"):
            assert bool(torch.isfinite(getattr(alone, name)).all()), name


def test_no_gaussians_leave_the_background_and_gradients_of_zero(gsplat_on_cpu: object) -> None:
    view = crowded(2, count=0)
    rendering, gradients = render_with_gradients(view, "cuda", torch.float32)
    assert torch.equal(rendering.image, view.background.expand_as(rendering.image))
    assert float(rendering.alpha.abs().sum()) == 0.0 and gradients["means"].shape == (0, 3)
