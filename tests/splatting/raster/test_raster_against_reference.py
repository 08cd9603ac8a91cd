"""The C++ kernels, every instruction set this machine has, against plain float64 torch."""

from __future__ import annotations

from functools import cache

import pytest
import torch
from raster_scenes import NAMES, by_reference, crowded, relative, render, render_with_gradients, scalar_of

from fastsplat.service.splatting.raster.image_formation import Backend, RasterSettings, Splats
from fastsplat.service.splatting.raster.kernels import running_with
from fastsplat.service.splatting.raster.rendering import accumulate_weights, rasterize
from fastsplat_contract.geometry.camera import Camera


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("channels", [1, 3, 6, 11, 20, 35])
def test_image_and_all_gradients(isa: str, seed: int, channels: int) -> None:
    view = crowded(seed, channels=channels)
    truth, wanted = by_reference(seed, channels=channels)
    ours, gradients = render_with_gradients(view, "cpu", torch.float32)
    assert float(truth.alpha.max()) > 0.99 and float(truth.alpha.min()) < 0.95
    for name in ("image", "alpha", "depth", "median_depth"):
        assert relative(getattr(ours, name), getattr(truth, name)) < 1e-5, name
    for name, gradient in gradients.items():
        assert relative(gradient, wanted[name]) < 1e-5, name
    assert torch.equal(ours.radii, truth.radii)


@cache
def _camera_gradient(seed: int, backend: Backend, dtype: torch.dtype, isa: str) -> torch.Tensor:
    view = crowded(seed, count=4200 if seed == 2 else 60)
    viewmat = view.viewmat.clone().requires_grad_()
    parts = [getattr(view.splats, name).to(dtype) for name in NAMES]
    out = rasterize(Splats(*parts), viewmat, view.camera, backend=backend)
    scalar_of(view, out).backward()
    assert viewmat.grad is not None and viewmat.grad.dtype == torch.float64
    return viewmat.grad


@pytest.mark.parametrize("seed", range(3))
def test_the_gradient_of_the_camera(isa: str, seed: int) -> None:
    truth = _camera_gradient(seed, "reference", torch.float64, "any")
    ours = _camera_gradient(seed, "cpu", torch.float32, isa)
    assert float(ours[3].abs().max()) == 0.0
    assert relative(ours[:3, :3], truth[:3, :3]) < 1e-4 and relative(ours[:3, 3], truth[:3, 3]) < 1e-4


def test_reference_gradients_are_the_derivative_of_the_reference_image() -> None:
    g = torch.Generator().manual_seed(3)
    means = torch.randn(8, 3, generator=g, dtype=torch.float64) * 0.5
    means[:, 2] += 3.0
    parts = [means, torch.randn(8, 4, generator=g, dtype=torch.float64)]
    parts += [torch.rand(8, 3, generator=g, dtype=torch.float64) * 0.3 + 0.05]
    parts += [torch.rand(8, generator=g, dtype=torch.float64), torch.randn(8, 2, generator=g, dtype=torch.float64)]
    viewmat = torch.eye(4, dtype=torch.float64).requires_grad_()
    camera = Camera(7, 5, 8.0, 9.0, 3.4, 2.3)

    def picture(pose: torch.Tensor, *tensors: torch.Tensor) -> tuple[torch.Tensor, ...]:
        out = rasterize(Splats(*tensors), pose, camera, backend="reference")
        return out.image, out.alpha, out.depth

    assert torch.autograd.gradcheck(picture, (viewmat, *(part.requires_grad_() for part in parts)))


def test_a_large_scene_stays_within_quantiles(isa: str) -> None:
    view = crowded(11, count=1500, width=130, height=94)
    truth, wanted = by_reference(11, count=1500, width=130, height=94)
    ours, gradients = render_with_gradients(view, "cpu", torch.float32)
    error = (ours.image.double() - truth.image).abs().amax(dim=-1).flatten()
    assert float(error.quantile(0.99)) < 1e-5
    assert float(error.max()) < 0.1  # a pixel may fall on the other side of a cut-off
    for name in NAMES:
        # Per Gaussian, so that one cut-off decided the other way cannot hide a wrong formula in the rest.
        rows = (gradients[name].double() - wanted[name]).reshape(len(wanted[name]), -1).norm(dim=1)
        size = wanted[name].reshape(len(wanted[name]), -1).norm(dim=1)
        seen = size > 1e-3 * size.max()
        assert float((rows / size)[seen].quantile(0.9)) < 1e-4, name


@pytest.mark.parametrize("width", [3, 20])
def test_accumulated_weights_are_weights_times_values(isa: str, width: int) -> None:
    view = crowded(2)
    values = torch.randn(29, 37, width, generator=torch.Generator().manual_seed(0))
    truth = accumulate_weights(view.splats, view.viewmat, view.camera, values, backend="reference")
    ours = accumulate_weights(view.splats, view.viewmat, view.camera, values, backend="cpu")
    assert relative(ours, truth) < 1e-5
    unit_image = torch.ones(29, 37, 1)
    weights = accumulate_weights(view.splats, view.viewmat, view.camera, unit_image)
    assert float(weights.sum()) == pytest.approx(float(render(view, "cpu").alpha.sum()), rel=1e-5)


def test_missing_gradients_count_as_zero(isa: str) -> None:
    view = crowded(5)
    parts = {name: getattr(view.splats, name).clone().requires_grad_() for name in NAMES}
    rendering = rasterize(Splats(**parts), view.viewmat, view.camera)
    (only_depth,) = torch.autograd.grad((rendering.depth * view.grad_depth).sum(), parts["means"])
    zero = torch.zeros_like
    still = view.with_splats()
    object.__setattr__(still, "grad_image", zero(view.grad_image))
    object.__setattr__(still, "grad_alpha", zero(view.grad_alpha))
    _, wanted = render_with_gradients(still, "reference", torch.float64)
    assert relative(only_depth, wanted["means"]) < 1e-5


@pytest.mark.parametrize("threads", [1, 2, 3, 5])
def test_bits_do_not_depend_on_threads(isa: str, threads: int) -> None:
    view = crowded(7, count=9000, width=90, height=70)
    view.viewmat.requires_grad_()
    with running_with(threads=1):
        first, wanted = render_with_gradients(view, "cpu", torch.float32)
    pose, view.viewmat.grad = view.viewmat.grad, None
    with running_with(threads=threads):
        second, gradients = render_with_gradients(view, "cpu", torch.float32)
    assert pose is not None and view.viewmat.grad is not None and torch.equal(pose, view.viewmat.grad)
    for name in ("image", "alpha", "depth", "median_depth", "radii"):
        assert torch.equal(getattr(first, name), getattr(second, name)), name
    for name in NAMES:
        assert torch.equal(gradients[name], wanted[name]), name


@pytest.mark.parametrize(
    "settings",
    [
        RasterSettings(alpha_max=0.999),
        RasterSettings(alpha_min=0.02, transmittance_min=0.05),
        RasterSettings(near=3.5, far=4.5, eps2d=0.1),
    ],
)
def test_cut_offs_mean_the_same_in_both_backends(isa: str, settings: RasterSettings) -> None:
    view = crowded(9)
    object.__setattr__(view, "settings", settings)
    truth, wanted = render_with_gradients(view, "reference", torch.float64)
    ours, gradients = render_with_gradients(view, "cpu", torch.float32)
    assert relative(ours.image, truth.image) < 1e-5
    for name, gradient in gradients.items():
        assert relative(gradient, wanted[name]) < 3e-5, name


def test_double_and_half_inputs_keep_their_type() -> None:
    view = crowded(1)
    truth = render(view, "reference", torch.float64)
    double = render(view, "cpu", torch.float64)
    half = render(view, "cpu", torch.float16)
    assert double.image.dtype == torch.float64 and half.image.dtype == torch.float16
    assert relative(double.image, truth.image) < 1e-5
    assert bool(torch.isfinite(half.image).all())
