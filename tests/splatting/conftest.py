"""Instruction sets, and a stand-in for gsplat where there is no GPU: its calling convention around `reference`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import torch
from torch import Tensor

from fastsplat.service.splatting.raster import cuda
from fastsplat.service.splatting.raster.kernels import instruction_sets, running_with
from fastsplat.service.splatting.raster.rendering import rasterize
from fastsplat.service.splatting.raster.types import RasterSettings, Splats
from fastsplat_contract.camera import Camera


class _Gsplat:
    """`gsplat.rasterization` of version 1.5: batches of views, `RGB+D` pictures, radii in x and y."""

    def __init__(self) -> None:
        self.calls = 0

    def rasterization(
        self,
        means: Tensor,
        quats: Tensor,
        scales: Tensor,
        opacities: Tensor,
        colors: Tensor,
        viewmats: Tensor,
        Ks: Tensor,  # noqa: N803 - gsplat's name
        width: int,
        height: int,
        *,
        near_plane: float,
        far_plane: float,
        eps2d: float,
        packed: bool,
        render_mode: str,
        rasterize_mode: str,
    ) -> tuple[Tensor, Tensor, dict[str, Any]]:
        assert render_mode == "RGB+D" and rasterize_mode == "classic" and not packed and len(means) > 0
        self.calls += 1
        settings = RasterSettings(alpha_max=0.999, near=near_plane, far=far_plane, eps2d=eps2d)
        drawn = []
        for index, (viewmat, k) in enumerate(zip(viewmats, Ks, strict=True)):
            camera = Camera(width, height, *(float(k[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2))))
            features = colors[index] if colors.ndim == 3 else colors
            splats = Splats(means, quats, scales, opacities, features)
            drawn.append(rasterize(splats, viewmat, camera, settings=settings, backend="reference"))
        pictures = torch.stack([torch.cat((out.image, out.depth[..., None]), dim=-1) for out in drawn])
        radii = torch.stack([out.radii[:, None].expand(-1, 2) for out in drawn])
        pairs = torch.zeros(int((radii > 0).sum()), dtype=torch.int64)
        return pictures, torch.stack([out.alpha for out in drawn])[..., None], {"radii": radii, "flatten_ids": pairs}


@pytest.fixture(params=instruction_sets())
def isa(request: pytest.FixtureRequest) -> Iterator[str]:
    """Each instruction set of this machine; the test runs with it."""
    with running_with(isa=request.param):
        yield request.param


@pytest.fixture
def gsplat_on_cpu(monkeypatch: pytest.MonkeyPatch) -> _Gsplat:
    """Backend `cuda` on CPU tensors: everything of it but gsplat's own kernels."""
    stand_in = _Gsplat()
    monkeypatch.setattr(cuda, "gsplat_module", lambda: stand_in)
    monkeypatch.setattr(cuda, "DEVICE", "cpu")
    return stand_in
