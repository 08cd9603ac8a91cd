"""The GPU backend: parity with `cpu` where there is a GPU, and a typed refusal where there is none."""

from __future__ import annotations

import importlib.util
from dataclasses import replace

import pytest
import torch
from raster_scenes import NAMES, View, crowded, relative, render

from fastsplat.service.splatting.raster import RasterSettings, Splats, blend_sums, rasterize
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
        blend_sums(view.splats, view.viewmat, view.camera, torch.ones(29, 37, 1), backend="cuda")


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
    sums = blend_sums(on_gpu, view.viewmat, view.camera, values.cuda(), backend="cuda").cpu()
    assert relative(sums, blend_sums(view.splats, view.viewmat, view.camera, values)) < 1e-3


@needs_gpu
def test_cut_offs_that_gsplat_fixes_are_refused() -> None:
    view = moderate()
    splats = Splats(**{name: getattr(view.splats, name).cuda() for name in NAMES})
    with pytest.raises(InvalidInputError):
        rasterize(splats, view.viewmat, view.camera, settings=replace(RasterSettings(), alpha_min=0.1), backend="cuda")
