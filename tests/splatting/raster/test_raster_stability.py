"""What must happen on the inputs that break rasterizers, for every backend that runs here."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest
import torch
from raster_scenes import NAMES, View, crowded, lone, relative, render, render_with_gradients
from torch import Tensor

from fastsplat.service.splatting.raster.image_formation import Backend, RasterSettings, Splats
from fastsplat.service.splatting.raster.kernels import instruction_sets, options_from, running_with
from fastsplat.service.splatting.raster.rendering import accumulate_weights, rasterize
from fastsplat_contract.errors import InvalidInputError, ResourceError
from fastsplat_contract.geometry.camera import Camera


@pytest.fixture(params=["reference", *instruction_sets()])
def backend(request: pytest.FixtureRequest) -> Iterator[Backend]:
    """`reference`, or `cpu` with each instruction set of this machine."""
    if request.param == "reference":
        yield "reference"
        return
    with running_with(isa=request.param):
        yield "cpu"


def assert_sane(view: View, backend: Backend) -> dict[str, Tensor]:
    """Everything finite, alpha in 0..1; returns the gradients."""
    rendering, gradients = render_with_gradients(view, backend, torch.float32)
    for name in ("image", "alpha", "depth", "median_depth"):
        assert bool(torch.isfinite(getattr(rendering, name)).all()), name
    assert float(rendering.alpha.min()) >= 0.0 and float(rendering.alpha.max()) <= 1.0
    for name, gradient in gradients.items():
        assert bool(torch.isfinite(gradient).all()), name
    return gradients


def assert_all(image: Tensor, value: float) -> None:
    assert float((image - value).abs().max()) < 2e-3


def test_needles_keep_their_direction(backend: Backend) -> None:
    g = torch.Generator().manual_seed(0)
    view = lone(scales=[[1e4, 1e-4, 1e-4]], quats=torch.randn(1, 4, generator=g).tolist())
    assert_sane(view, backend)
    truth = render(view, "reference", torch.float64)
    assert float(truth.alpha.max()) > 0.5  # it is in the picture
    assert relative(render(view, backend).alpha, truth.alpha) < 1e-4


@pytest.mark.parametrize("angle", [0.1, 0.7, 2.0])
def test_needle_gradients(angle: float) -> None:
    turn = [[float(torch.cos(torch.tensor(angle / 2))), 0.0, 0.0, float(torch.sin(torch.tensor(angle / 2)))]]
    view = lone(scales=[[30.0, 0.01, 0.01]], quats=turn, means=[[0.01, 0.02, 2.0]])
    _, wanted = render_with_gradients(view, "reference", torch.float64)
    _, gradients = render_with_gradients(view, "cpu", torch.float32)
    for name in NAMES:
        assert relative(gradients[name], wanted[name]) < 1e-4, name


@pytest.mark.parametrize(
    ("place", "opacity", "seen"),
    [
        *(((0.0, 0.0, z), 0.8, False) for z in (0.0, -1.0, 0.01 - 1e-6, 2e10)),
        *(((0.0, 0.0, z), 0.8, True) for z in (0.01 + 1e-6, 1e9)),
        # Half a pixel of offset puts the mean on a pixel centre.
        *(
            ((0.0625, 0.0625, 2.0), opacity, opacity > 1 / 255)
            for opacity in (0.0, 1 / 255 - 1e-6, 1 / 255 + 1e-6, 1.0)
        ),
    ],
)
def test_near_far_behind_and_opacity_at_its_limits(
    backend: Backend, place: tuple[float, ...], opacity: float, seen: bool
) -> None:
    view = lone(means=[place], opacities=[opacity], scales=[[0.3 * max(place[2], 0.01)] * 3])
    rendering = render(view, backend)
    assert (float(rendering.alpha.max()) > 0) == (int(rendering.radii[0]) > 0) == seen
    assert float(rendering.alpha.max()) <= 0.99 + 1e-6
    assert_sane(view, backend)


@pytest.mark.parametrize("steps", [-2, -1, 0, 1, 2])
def test_opacity_a_bit_beside_the_cut_off_is_drawn_faintly_or_not_at_all(backend: Backend, steps: int) -> None:
    opacity = torch.tensor(1.0 / 255.0)
    for _ in range(abs(steps)):
        opacity = torch.nextafter(opacity, torch.tensor(torch.inf if steps > 0 else 0.0))
    view = lone(opacities=[float(opacity)], means=[[0.0625, 0.0625, 2.0]])
    gradients = assert_sane(view, backend)
    alpha = render(view, backend).alpha
    assert float(alpha.max()) < 1.01 / 255 and int((alpha > 0).sum()) <= 1
    assert float(gradients["opacities"].abs().max()) < 10.0


def test_no_gaussians_have_no_weights(backend: Backend) -> None:
    view, values = crowded(0, count=0), torch.ones(29, 37, 2)
    assert accumulate_weights(view.splats, view.viewmat, view.camera, values, backend=backend).shape == (0, 2)


def test_equal_depths_are_drawn_in_order_of_rows(backend: Backend) -> None:
    colors = [[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]
    view = lone(means=[[0.0, 0.0, 2.0]] * 3, scales=[[9.0] * 3] * 3, opacities=[0.5] * 3, features=colors)
    image = render(view, backend).image
    assert image[8, 8].tolist() == pytest.approx([0.5, 0.25, 0.125], abs=1e-3)


def test_saturated_pixels_stop_and_hidden_rows_get_no_gradient(backend: Backend) -> None:
    count = 40
    means = [[0.0, 0.0, 1.0 + 0.1 * i] for i in range(count)]
    view = lone(means=means, scales=[[50.0] * 3] * count, opacities=[0.9] * count)
    rendering, gradients = render_with_gradients(view, backend, torch.float32)
    # 0.1^3 is above the limit of 1e-4, the fourth would take it to the limit: three are drawn.
    assert_all(rendering.alpha, 0.999)
    assert float(gradients["features"][:3].abs().min()) > 0.0
    assert float(gradients["features"][5:].abs().max()) == 0.0


def test_median_depth_is_where_half_is_passed(backend: Backend) -> None:
    means = [[0.0, 0.0, 2.0], [0.0, 0.0, 3.0], [0.0, 0.0, 4.0]]
    view = lone(means=means, scales=[[90.0] * 3] * 3, opacities=[0.3, 0.4, 0.9])
    assert_all(render(view, backend).median_depth, 3.0)
    faint = view.with_splats(opacities=torch.tensor([0.1, 0.1, 0.1]))
    assert float(render(faint, backend).median_depth.max()) == 0.0


def test_denormal_inputs(backend: Backend) -> None:
    tiny = 1e-42
    assert_sane(lone(means=[[tiny, -tiny, 2.0]], scales=[[tiny, tiny, 0.1]], features=[[tiny, 0.0, -tiny]]), backend)
    view = lone(quats=[[tiny, 0.0, 0.0, 0.0]], opacities=[tiny])
    assert_sane(view, backend)
    assert float(render(view, backend).alpha.max()) == 0.0
    turned = lone(quats=[[1e-39, 0.0, 0.0, 1e-39]], scales=[[0.6, 0.1, 0.2]])
    wanted = lone(quats=[[1.0, 0.0, 0.0, 1.0]], scales=[[0.6, 0.1, 0.2]])
    assert relative(render(turned, backend).alpha, render(wanted, backend).alpha) < 1e-4


def test_half_precision_storage_at_its_limits(backend: Backend) -> None:
    view = lone(scales=[[6e-8, 65504.0, 1.0]], features=[[65504.0, -65504.0, 6e-8]], means=[[0.0, 0.0, 65504.0]])
    stored = view.with_splats(**{name: getattr(view.splats, name).half().float() for name in NAMES})
    assert_sane(stored, backend)
    small = lone(
        quats=[[6e-8, 0.0, 0.0, 6e-8]], opacities=[0.9995], scales=[[6e-8, 6e-5, 0.3]], means=[[0.0, 0.0, 0.5]]
    )
    stored = small.with_splats(**{name: getattr(small.splats, name).half() for name in NAMES})
    for name in NAMES:
        assert bool(torch.isfinite(getattr(stored.splats, name)).all())
    rendering = render(stored, backend, torch.float16)
    truth = render(stored, "reference", torch.float64)
    assert rendering.alpha.dtype == torch.float16 and relative(rendering.alpha, truth.alpha) < 1e-3
    assert float(truth.alpha.max()) > 0.4


def test_the_bound_on_intersections_is_named(backend: Backend) -> None:
    view = crowded(0)
    with pytest.raises(ResourceError) as caught:
        rasterize(view.splats, view.viewmat, view.camera, settings=RasterSettings(max_isects=20), backend=backend)
    assert caught.value.field == "max_isects" and "max_isects" in caught.value.limit


def test_a_blanket_over_a_large_image_meets_the_bound_instead_of_memory(backend: Backend) -> None:
    blanket = lone(scales=[[1e6] * 3]).splats
    splats = Splats(*(torch.cat([getattr(blanket, name)] * 400) for name in NAMES))
    camera = Camera(4000, 3000, 4000.0, 4000.0, 2000.0, 1500.0)
    with pytest.raises(ResourceError):
        rasterize(splats, torch.eye(4), camera, settings=RasterSettings(max_isects=100_000), backend=backend)


def test_inputs_that_do_not_fit_are_refused(backend: Backend) -> None:
    view = crowded(0)
    splats, viewmat = view.splats, view.viewmat
    short, settings = replace(splats, scales=splats.scales[:5]), RasterSettings(alpha_min=0.0)
    for parts, options in ((short, {}), (splats, {"settings": settings}), (splats, {"background": torch.zeros(2)})):
        with pytest.raises(InvalidInputError):
            rasterize(parts, viewmat, view.camera, backend=backend, **options)
    with pytest.raises(InvalidInputError):
        accumulate_weights(splats, viewmat, view.camera, torch.ones(3, 3, 1), backend=backend)


def test_threads_and_instruction_set_come_from_the_environment_and_bad_ones_are_refused() -> None:
    options = options_from({"FASTSPLAT_RASTER_ISA": "baseline", "FASTSPLAT_RASTER_THREADS": "3"})
    assert (options.isa, options.threads) == ("baseline", 3)
    default = options_from({"FASTSPLAT_RASTER_ISA": ""})
    assert default.isa == instruction_sets()[0] and 1 <= default.threads <= 64
    bad = ("altivec", "FASTSPLAT_RASTER_ISA"), *((n, "FASTSPLAT_RASTER_THREADS") for n in ("0", "257", "-1", "two"))
    for value, name in bad:
        with pytest.raises(InvalidInputError) as caught:
            options_from({name: value})
        assert caught.value.field == name


def test_an_instruction_set_can_be_asked_for_and_a_missing_one_is_refused() -> None:
    view = crowded(0)
    with pytest.raises(InvalidInputError), running_with(isa="altivec"):
        render(view, "cpu")
    with running_with(isa="baseline"):
        assert bool(torch.isfinite(render(view, "cpu").image).all())
