"""Extremes of every input: what comes of each, and how exact gradients are, as a table of `docs/method.md` says."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from math import inf, nan
from pathlib import Path
from typing import Any

import pytest
import torch
from raster_scenes import NAMES, View, crowded, lone, render, render_with_gradients
from torch import Tensor

from fastsplat.service.splatting.losses.functional import image_loss, semantic_loss
from fastsplat.service.splatting.raster.image_formation import Backend, Splats
from fastsplat.service.splatting.raster.kernels import instruction_sets, running_with
from fastsplat.service.splatting.raster.rendering import rasterize
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import Camera

PAGE = Path(__file__).parents[3] / "docs" / "method.md"
Tensors = Mapping[str, Tensor]
Result = tuple[str, float]
"""What came of it, and the largest relative error of the picture or a gradient against float64."""
_BAD, _BADLY, _FASTEST = (nan, inf, -inf), "NaN, Inf, −Inf", instruction_sets()[:1]


@dataclass(frozen=True)
class Case:
    """A row of the table: `run` with a backend must give `outcome` and gradients within `error`."""

    what: str
    value: str
    outcome: str
    run: Callable[[Backend], Result]
    error: float = 1e-5
    ways: tuple[str, ...] = ("reference", *instruction_sets())

    def row(self) -> str:
        return f"| {self.what} | {self.value} | {self.outcome} | {f'{self.error:.0e}' if self.error else ''} |"


def _error(ours: Tensors, truth: Tensors) -> float:
    """The largest; a gradient less than a millionth of the largest one is measured against that."""
    assert all(bool(gradient.isfinite().all()) for gradient in ours.values())
    least = max(1e-30, 1e-6 * max(float(gradient.norm()) for gradient in truth.values()))
    return max(float((ours[name] - truth[name]).norm()) / max(float(truth[name].norm()), least) for name in truth)


def _drawn(*views: View) -> Callable[[Backend], Result]:
    def run(backend: Backend) -> Result:
        outcomes, errors = set(), []
        for view in views:
            rendering, ours = render_with_gradients(view, backend, torch.float32)
            exact, truth = render_with_gradients(view, "reference", torch.float64)
            most = float(rendering.alpha.max())
            broken = "left out, the others " if rendering.culled_non_finite else ""
            outcomes.add(broken + (f"drawn, opacity {most:.2f}" if most else "nothing drawn"))
            errors.append(_error(ours | {"picture": rendering.image}, truth | {"picture": exact.image}))
        (outcome,) = outcomes
        return outcome, max(errors)

    return run


def _large(splats: Splats, camera: Camera) -> Callable[[Backend], Result]:
    def run(backend: Backend) -> Result:
        image = rasterize(splats, torch.eye(4), camera, backend=backend).image
        assert bool(image.isfinite().all()) and float(image.max()) <= 1.0
        return "drawn", 0.0

    return run


def _many(count: int) -> Splats:
    g = torch.Generator().manual_seed(0)
    means = torch.rand(count, 3, generator=g) * torch.tensor([2.0, 2, 4]) + torch.tensor([-1.0, -1, 1])
    quats = torch.randn(count, 4, generator=g)
    return Splats(
        means, quats, torch.full((count, 3), 0.003), torch.full((count,), 0.2), torch.rand(count, 3, generator=g)
    )


def _labels(count: int, size: float = 1.0, name: str = "", value: float = 0.0) -> Callable[[Backend], Result]:
    """The cross-entropy over `count` labels, with logits of about `size`."""

    def run(backend: Backend) -> Result:
        g = torch.Generator().manual_seed(0)
        codes, weight = torch.randn(6, 7, 8, generator=g), size * torch.randn(count, 8, generator=g)
        case = {"codes_image": codes, "weight": weight, "bias": size * torch.randn(count, generator=g)}
        case |= {"labels": torch.arange(42).reshape(6, 7) % count, "class_weights": torch.ones(count)}
        if name:
            case[name].view(-1)[0] = value
        return _loss(semantic_loss, case, ("codes_image", "weight", "bias"))

    return run


def _colors(name: str, value: float) -> Callable[[Backend], Result]:
    def run(backend: Backend) -> Result:
        image, target = torch.rand(2, 14, 15, 3, generator=torch.Generator().manual_seed(7))
        case = {"image": image, "target": target}
        case[name][5, 6, 0] = value
        return _loss(lambda image, target: image_loss(image, target, 0.2), case, ("image",))

    return run


def _loss(loss: Callable[..., Tensor], case: Tensors, learnt: tuple[str, ...]) -> Result:
    gradients: list[Tensors] = []
    for dtype in (torch.float32, torch.float64):
        parts = {name: part.to(dtype) if part.is_floating_point() else part for name, part in case.items()}
        inputs = [parts[name].requires_grad_() for name in learnt]
        value = loss(**parts)
        assert bool(value.isfinite())
        gradients.append(dict(zip(learnt, torch.autograd.grad(value, inputs), strict=True)))
    return "a finite loss", _error(*gradients)


def _refused(*runs: Callable[[Backend], Any]) -> Callable[[Backend], Result]:
    def run(backend: Backend) -> Result:
        fields = set()
        for attempt in runs:
            with pytest.raises(InvalidInputError) as refused:
                attempt(backend)
            fields.add(refused.value.field)
        (field,) = fields
        return f"refused by the name `{field}`", 0.0

    return run


def _broken(name: str, bad: float) -> View:
    view = crowded(4)
    values = getattr(view.splats, name).clone()
    values.view(60, -1)[17, -1] = bad
    return view.with_splats(**{name: values})


def _cases() -> Iterator[Case]:
    for value in (0.0, 1e-30, 1e-6):
        yield Case("scale", f"{value:g}", "drawn, opacity 0.35", _drawn(lone(scales=[[value] * 3])), 1e-4)
    for value in (1.0, 1e6, 1e15, 1e30, 3e38):
        yield Case("scale", f"{value:g}", "drawn, opacity 0.80", _drawn(lone(scales=[[value] * 3])))
    for value, outcome in ((0.0, "nothing drawn"), (1.0, "drawn, opacity 0.99")):
        yield Case("opacity", f"{value:g}", outcome, _drawn(lone(opacities=[value], means=[[0.0625, 0.0625, 2.0]])))
    for value in (0.0, 1e-36, 1e-20, 1e20, 1e38):
        quats = (torch.tensor([[0.9, 0.1, -0.3, 0.2]]) * value).tolist()
        outcome = "drawn, opacity 0.76" if value else "nothing drawn"
        yield Case("quaternion's length", f"{value:g}", outcome, _drawn(lone(quats=quats, scales=[[0.6, 0.1, 0.2]])))
    for name, mean, scale, outcome in (
        ("1e6 ahead", [0.0, 0.0, 1e6], 3e5, "drawn, opacity 0.79"),
        ("1e6 behind", [0.0, 0.0, -1e6], 0.3, "nothing drawn"),
        *((f"{x:g} aside at the near plane", [x, -x, 0.0101], 0.01, "nothing drawn") for x in (0.5, 1e6, 1e38)),
        ("the camera is inside", [0.0, 0.0, 0.0101], 3.0, "drawn, opacity 0.80"),
    ):
        yield Case("position", name, outcome, _drawn(lone(means=[mean], scales=[[scale] * 3])))
    for width, height in ((1, 1), (1, 40), (16, 16), (17, 15), (33, 1)):
        view = crowded(6, width=width, height=height)
        yield Case("picture", f"{width}×{height}", "drawn, opacity 1.00", _drawn(view))
    large = _large(_many(1_000), Camera(7680, 4320, 4000.0, 4000.0, 3840.0, 2160.0))
    yield Case("picture", "7680×4320", "drawn", large, 0.0, _FASTEST)
    for count, outcome in ((0, "nothing drawn"), (1, "drawn, opacity 0.82"), (60, "drawn, opacity 1.00")):
        yield Case("Gaussians", f"{count:,}", outcome, _drawn(crowded(4, count=count)))
    many = _large(_many(10**6), Camera(64, 48, 40.0, 40.0, 32.0, 24.0))
    yield Case("Gaussians", "1,000,000", "drawn", many, 0.0, _FASTEST)
    for count in (1, 10, 10_000):
        yield Case("labels", f"{count:,}", "a finite loss", _labels(count), 1e-4, _FASTEST)
    for size in (1e-4, 1e4):
        yield Case("logits", f"±{size:g}", "a finite loss", _labels(17, size), 1e-4, _FASTEST)
    for name in NAMES:
        views = [_broken(name, bad) for bad in _BAD]
        yield Case(f"a Gaussian's {name}", _BADLY, "left out, the others drawn, opacity 1.00", _drawn(*views))
    view = crowded(4)
    for name in ("viewmat", "background"):
        changed = [replace(view, **{name: getattr(view, name) * bad}) for bad in _BAD]
        runs = [lambda backend, view=view: render(view, backend) for view in changed]
        yield Case(name, _BADLY, f"refused by the name `{name}`", _refused(*runs), 0.0)
    for name in ("codes_image", "weight", "bias", "class_weights"):
        runs = [_labels(17, 1.0, name, bad) for bad in _BAD]
        yield Case(name, _BADLY, f"refused by the name `{name}`", _refused(*runs), 0.0, _FASTEST)
    for name in ("image", "target"):
        runs = [_colors(name, bad) for bad in _BAD]
        yield Case(name, _BADLY, f"refused by the name `{name}`", _refused(*runs), 0.0, _FASTEST)


_CASES = tuple(_cases())


@pytest.mark.parametrize(
    ("case", "way"),
    [pytest.param(case, way, id=f"{case.what} {case.value} {way}") for case in _CASES for way in case.ways],
)
def test_an_extreme_is_a_right_number_or_refused(case: Case, way: str) -> None:
    with running_with(isa=instruction_sets()[0] if way == "reference" else way):
        outcome, error = case.run("reference" if way == "reference" else "cpu")
    assert outcome == case.outcome and error <= case.error


def test_the_page_says_so() -> None:
    table = "\n".join(case.row() for case in _CASES)
    assert table in PAGE.read_text(), f"docs/method.md lacks this table:\n{table}"
