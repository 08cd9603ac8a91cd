"""Small scenes that provoke errors: anisotropic, off-axis, overlapping, nearly opaque."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import torch
from torch import Tensor

from fastsplat.service.splatting.raster.image_formation import Backend, RasterSettings, Rendering, Splats
from fastsplat.service.splatting.raster.rendering import rasterize
from fastsplat_contract.geometry.camera import Camera

NAMES = ("means", "quats", "scales", "opacities", "features")


@dataclass(frozen=True)
class View:
    """A scene, float32, with weights that turn a rendering into a scalar."""

    splats: Splats
    viewmat: Tensor
    camera: Camera
    background: Tensor
    grad_image: Tensor
    grad_alpha: Tensor
    grad_depth: Tensor
    settings: RasterSettings = field(default_factory=RasterSettings)

    def with_splats(self, **tensors: Tensor) -> View:
        return replace(self, splats=replace(self.splats, **tensors))


def crowded(seed: int, count: int = 60, channels: int = 6, width: int = 37, height: int = 29) -> View:
    """Overlapping needles and discs, opacities mostly near 1, a tilted camera with an off-centre principal point."""
    g = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=g)

    means = normal(count, 3)
    means[:, 2] += 4.0
    spin = torch.tensor([[0.0, -0.05, 0.2], [0.05, 0.0, -0.1], [-0.2, 0.1, 0.0]], dtype=torch.float64)
    viewmat = torch.eye(4, dtype=torch.float64)
    viewmat[:3, :3] = torch.linalg.matrix_exp(spin)
    viewmat[:3, 3] = torch.tensor([0.1, -0.1, 0.2])
    splats = Splats(
        means,
        2.0 * normal(count, 4),
        torch.exp(1.2 * normal(count, 3) - 1.5),
        torch.rand(count, generator=g) ** 0.3,
        normal(count, channels),
    )
    return View(
        splats,
        viewmat,
        Camera(width, height, 30.0, 32.0, width / 2 + 0.7, height / 2 - 0.4),
        torch.rand(channels, generator=g),
        normal(height, width, channels),
        normal(height, width),
        normal(height, width),
    )


def lone(**changes: list[Any]) -> View:
    """One Gaussian two units ahead, or as many as there are means, 16×16 pixels, unless told otherwise."""
    usual = [0.0, 0.0, 2.0], [1.0, 0.0, 0.0, 0.0], [0.3, 0.3, 0.3], 0.8, [1.0, 0.5, 0.25]
    count = len(changes.get("means", [0]))
    values = {name: [value] * count for name, value in zip(NAMES, usual, strict=True)} | changes
    parts = {name: torch.tensor(values[name], dtype=torch.float32) for name in NAMES}
    unit_image = torch.ones(16, 16)
    camera = Camera(16, 16, 16.0, 16.0, 8.0, 8.0)
    return View(Splats(**parts), torch.eye(4), camera, torch.zeros(3), torch.ones(16, 16, 3), unit_image, unit_image)


def render(view: View, backend: Backend, dtype: torch.dtype = torch.float32) -> Rendering:
    parts = [getattr(view.splats, name).to(dtype) for name in NAMES]
    return rasterize(
        Splats(*parts),
        view.viewmat,
        view.camera,
        background=view.background.to(dtype),
        settings=view.settings,
        backend=backend,
    )


def scalar_of(view: View, rendering: Rendering) -> Tensor:
    """A rendering times the weights of a view."""
    pairs = (rendering.image, view.grad_image), (rendering.alpha, view.grad_alpha), (rendering.depth, view.grad_depth)
    return sum((part * weights.to(part)).sum() for part, weights in pairs)


def render_with_gradients(view: View, backend: Backend, dtype: torch.dtype) -> tuple[Rendering, dict[str, Tensor]]:
    """The rendering, and d(scalar)/d(input) for every input and the background."""
    parts = {name: getattr(view.splats, name).detach().to(dtype, copy=True).requires_grad_() for name in NAMES}
    background = view.background.detach().to(dtype, copy=True).requires_grad_()
    rendering = rasterize(
        Splats(**parts), view.viewmat, view.camera, background=background, settings=view.settings, backend=backend
    )
    scalar_of(view, rendering).backward()
    parts["background"] = background
    rendering = replace(
        rendering, image=rendering.image.detach(), alpha=rendering.alpha.detach(), depth=rendering.depth.detach()
    )
    return rendering, {name: part.grad for name, part in parts.items() if part.grad is not None}


@cache
def by_reference(seed: int, **shape: int) -> tuple[Rendering, dict[str, Tensor]]:
    """The same of `crowded(seed, ...)` in float64 by the reference: once for all instruction sets."""
    return render_with_gradients(crowded(seed, **shape), "reference", torch.float64)


def relative(value: Tensor, truth: Tensor) -> float:
    """Relative L2 distance."""
    return float((value.detach().double() - truth.detach().double()).norm() / truth.detach().double().norm())
