"""The fused losses and Adam against their torch twins in float64, and at the ends of their arguments."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
import torch
from torch import Tensor

from fastsplat.service.splatting.losses import functional, one_pass, torch_losses
from fastsplat.service.splatting.losses.functional import image_loss, semantic_loss
from fastsplat.service.splatting.optim import adam_update
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat.service.splatting.raster.kernels import instruction_sets, running_with
from fastsplat.service.splatting.training.depth_regularization import depth_roughness, depth_spread, surface_loss
from fastsplat_contract.errors import InvalidInputError


@pytest.fixture(params=(*instruction_sets(), "one_pass"))
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Every implementation in float32 of the losses; `one_pass` is what a GPU runs."""
    if request.param == "one_pass":
        monkeypatch.setattr(functional, "_fused", lambda *_: False)
        monkeypatch.setattr(one_pass, "_LOGITS", 50_000)
        yield request.param
    else:
        with running_with(isa=request.param):
            yield request.param


def assert_follows(
    ours: Callable[..., Tensor], truth: Callable[..., Tensor], inputs: tuple[Tensor, ...], bound: float
) -> None:
    """A loss in float32 and its gradients are those in float64."""
    mine, exact = ([p.to(dtype, copy=True).requires_grad_() for p in inputs] for dtype in (torch.float, torch.double))
    loss, wanted = ours(*mine), truth(*exact)
    assert float(loss.detach()) == pytest.approx(float(wanted.detach()), rel=bound, abs=1e-7)
    gradients = torch.autograd.grad(3.0 * loss, mine), torch.autograd.grad(3.0 * wanted, exact)
    for gradient, expected in zip(*gradients, strict=True):
        assert float((gradient - expected).norm()) <= bound * float(expected.norm()) + 1e-9


def pictures(height: int, width: int, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    g = torch.Generator().manual_seed(seed)
    target = torch.rand(height, width, 3, generator=g)
    image = (target + 0.2 * torch.randn(height, width, 3, generator=g)).clamp(0, 1)
    return image, target, torch.rand(height, width, generator=g) > 0.3


@pytest.mark.parametrize(("height", "width"), [(1, 1), (7, 5), (11, 17), (37, 61), (64, 48)])
@pytest.mark.parametrize("weight", [0.0, 0.2, 1.0])
@pytest.mark.parametrize("masked", [False, True])
def test_image_loss_and_gradient(way: str, height: int, width: int, weight: float, masked: bool) -> None:
    image, target, valid = pictures(height, width)
    mask = valid if masked else None
    assert_follows(
        lambda x: image_loss(x, target, weight, mask),
        lambda x: torch_losses.image_loss(x, target.double(), weight, mask),
        (image,),
        3e-5,
    )


@pytest.mark.parametrize(("height", "width"), [(1, 1), (3, 40), (37, 61), (90, 130)])
@pytest.mark.parametrize("weights", [(1.0, 0.0), (0.0, 1.0), (0.3, 0.7)])
@pytest.mark.parametrize("masked", [False, True])
def test_surface_loss_and_gradients(
    isa: str, height: int, width: int, weights: tuple[float, float], masked: bool
) -> None:
    g = torch.Generator().manual_seed(height)
    _, target, valid = pictures(height, width)
    target = torch.where(torch.rand(height, width, 1, generator=g) > 0.3, 0.5, target)  # colors without and with edges
    alpha = torch.rand(height, width, generator=g)
    depth = alpha * (2 + 0.3 * torch.rand(height, width, generator=g))
    last = torch.stack([torch.zeros(height, width), depth * depth / alpha + torch.rand(height, width, generator=g)], 2)
    alpha[0, 0] = 0.0
    mask = valid if masked else None
    assert_follows(
        lambda a, d, s: surface_loss(a, d, s[..., 1], target, mask, *weights),
        lambda a, d, s: (
            weights[0] * depth_spread(a, d, s[..., 1]) + weights[1] * depth_roughness(a, d, target.double(), mask)
        ),
        (alpha, depth, last),
        1e-4,
    )


def test_layouts_other_than_the_kernels_are_copied_not_misread() -> None:
    image, target, valid = pictures(20, 30)
    flipped = image.flip(1).contiguous().flip(1)
    columns = target.permute(1, 0, 2).contiguous().permute(1, 0, 2)
    assert torch.equal(image_loss(flipped, columns, 0.2, valid), image_loss(image, target, 0.2, valid))


def semantic_case(classes: int, size: int, height: int = 23, width: int = 31) -> tuple[Tensor, ...]:
    g = torch.Generator().manual_seed(classes * 100 + size)
    codes = torch.randn(height, width, size, generator=g)
    weight, bias = torch.randn(classes, size, generator=g), torch.randn(classes, generator=g)
    labels = torch.randint(0, classes, (height, width), generator=g)
    weights = torch.rand(classes, generator=g)
    weights[0] = 0.0 if classes > 1 else 1.0
    return codes, weight, bias, labels, weights


@pytest.mark.parametrize(("classes", "size"), [(1, 3), (2, 1), (5, 3), (21, 8), (18, 5), (300, 6), (10_000, 3)])
def test_semantic_loss_and_gradients(way: str, classes: int, size: int) -> None:
    case = semantic_case(classes, size)
    double = (case[3], case[4].double())
    ways = (lambda *x: semantic_loss(*x, *case[3:])), (lambda *x: torch_losses.semantic_loss(*x, *double))
    assert_follows(*ways, case[:3], 1e-5)


def test_codes_are_read_in_place_from_an_image_of_more_channels(isa: str) -> None:
    codes, weight, bias, labels, weights = semantic_case(9, 4)
    image = torch.cat((torch.rand(23, 31, 3), codes), dim=2).requires_grad_()
    loss = semantic_loss(image[..., 3:], weight, bias, labels, weights)
    loss.backward()
    alone = codes.clone().requires_grad_()
    semantic_loss(alone, weight, bias, labels, weights).backward()
    assert torch.equal(image.grad[..., 3:], alone.grad) and float(image.grad[..., :3].abs().max()) == 0.0


@pytest.mark.parametrize("threads", [2, 3, 7])
def test_bits_do_not_depend_on_threads(threads: int) -> None:
    image, target, _ = pictures(130, 90)
    codes, weight, bias, labels, weights = semantic_case(12, 6, 130, 90)

    def everything() -> list[Tensor]:
        parts = [part.clone().requires_grad_() for part in (image, codes, weight, bias)]
        first = image_loss(parts[0], target, 0.2)
        second = semantic_loss(*parts[1:], labels, weights)
        (first + second).backward()
        grads = [part.grad for part in parts if part.grad is not None]
        return [first.detach(), second.detach(), *grads]

    with running_with(threads=1):
        alone = everything()
    with running_with(threads=threads):
        together = everything()
    for mine, theirs in zip(together, alone, strict=True):
        assert torch.equal(mine, theirs)


@pytest.mark.parametrize("kernels", [*instruction_sets(), "torch"])
@pytest.mark.parametrize("shape", [(1,), (37, 3), (20_001, 4)])
def test_many_steps_follow_torch(kernels: str, shape: tuple[int, ...]) -> None:
    backend: Backend = "reference" if kernels == "torch" else "cpu"
    g = torch.Generator().manual_seed(0)
    param = torch.randn(*shape, generator=g)
    theirs = param.double().clone().requires_grad_()
    torchs = torch.optim.Adam([theirs], lr=1e-2, eps=1e-15)
    exp_avg, exp_avg_sq = torch.zeros(shape), torch.zeros(shape)
    with running_with(isa=None if kernels == "torch" else kernels):
        for step in range(1, 8):
            grad = torch.randn(*shape, generator=g) * 10.0 ** (step - 4)
            adam_update(param, grad, exp_avg, exp_avg_sq, lr=1e-2, step=step, backend=backend)
            theirs.grad = grad.double()
            torchs.step()
    assert float((param - theirs.detach()).abs().max()) < 2e-6


def test_no_gradient_ever_means_no_step() -> None:
    param, zero = torch.ones(5), torch.zeros(5)
    adam_update(param, zero, torch.zeros(5), torch.zeros(5), lr=1.0, step=1)
    assert torch.equal(param, torch.ones(5))


def test_what_does_not_fit_is_refused() -> None:
    parts = [torch.zeros(4) for _ in range(4)]
    for bad, step in ((parts, 0), ([parts[0].double(), *parts[1:]], 1), ([parts[0], parts[1][:2], *parts[2:]], 1)):
        with pytest.raises(InvalidInputError):
            adam_update(*bad, lr=0.1, step=step)
