"""Spherical harmonics: the kernels against torch in float64, the basis against its own laws, and the poles."""

from __future__ import annotations

import math

import pytest
import torch

from fastsplat.service.common.sh_degree import MAX_SH_DEGREE
from fastsplat.service.scene.artefact.scene import SH_C0, SH_COUNTS
from fastsplat.service.splatting.raster import harmonics
from fastsplat.service.splatting.raster.kernels import kernels
from fastsplat.service.splatting.raster.rendering import sh_to_rgb
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat_contract.errors import InvalidInputError
from tests.splatting.gsplat_front_end import needs_gpu

DEGREES = pytest.mark.parametrize("degree", [0, 1, 2, 3])


@DEGREES
@pytest.mark.parametrize("backend", ["cpu", "cuda"])
def test_colors_and_gradients(degree: int, backend: str, isa: str, gsplat_on_cpu: object) -> None:
    assert_same(degree, backend, torch.device("cpu"))


@DEGREES
@needs_gpu
def test_so_have_gsplats_kernels(degree: int) -> None:
    assert_same(degree, "cuda", torch.device("cuda"))


def assert_same(degree: int, backend: str, device: torch.device) -> None:
    """Values and gradients of a backend against the reference."""
    g = torch.Generator().manual_seed(degree)
    means, sh, up = (torch.randn(*shape, generator=g) for shape in ((500, 3), (500, 16, 3), (500, 3)))
    camera = torch.tensor([0.3, -0.2, 0.1])
    results = []
    for way, dtype, place in (("reference", torch.float64, torch.device("cpu")), (backend, torch.float32, device)):
        parts = [part.to(place, dtype, copy=True).requires_grad_() for part in (means, sh)]
        rgb = sh_to_rgb(*parts, camera.to(place, dtype), degree, backend=way)
        (rgb * up.to(place, dtype)).sum().backward()
        by_means = parts[0].grad if degree else torch.zeros(500, 3)
        results.append([part.detach().cpu() for part in (rgb, by_means, parts[1].grad)])
    for truth, ours in zip(*results, strict=True):
        assert float((ours - truth).norm()) <= 2e-5 * float(truth.norm())


def test_the_basis_is_orthonormal_on_the_sphere() -> None:
    g = torch.Generator().manual_seed(0)
    directions = torch.nn.functional.normalize(torch.randn(400_000, 3, generator=g, dtype=torch.float64), dim=1)
    values = harmonics.basis(directions, 3)
    gram = 4 * torch.pi * values.T @ values / len(values)
    assert float((gram - torch.eye(16)).abs().max()) < 0.03


@DEGREES
def test_poles_axes_and_a_gaussian_at_the_camera(degree: int, backend: str) -> None:
    means = torch.tensor([[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0], [0, -1.0, 0], [0, 0, 0], [1e-30, 0, 0], [1e30, 0, 0]])
    means.requires_grad_()
    sh = torch.ones(7, 16, 3, requires_grad=True)
    rgb = sh_to_rgb(means, sh, torch.zeros(3), degree, backend=backend)
    rgb.sum().backward()
    assert bool(torch.isfinite(rgb).all())
    assert sh.grad is not None and bool(torch.isfinite(sh.grad).all())
    if degree:
        assert means.grad is not None and bool(torch.isfinite(means.grad[:5]).all())


def test_unused_coefficients_do_not_matter_and_short_ones_are_refused() -> None:
    means, sh = torch.randn(4, 3), torch.randn(4, 16, 3)
    short = sh[:, :4].contiguous()
    assert torch.equal(sh_to_rgb(means, sh, torch.zeros(3), 1), sh_to_rgb(means, short, torch.zeros(3), 1))
    with pytest.raises(InvalidInputError):
        sh_to_rgb(means, sh[:, :4], torch.zeros(3), 2)
    with pytest.raises(InvalidInputError):
        sh_to_rgb(means, sh, torch.zeros(3), 4)


def test_python_and_kernels_know_the_same_degrees() -> None:
    assert kernels.MAX_SH_DEGREE == MAX_SH_DEGREE == len(TrainingSettings().sh_from)
    assert SH_COUNTS[-1] == (MAX_SH_DEGREE + 1) ** 2
    directions = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
    assert float(harmonics.basis(directions, 0)) == SH_C0 == pytest.approx(0.5 / math.sqrt(math.pi))
