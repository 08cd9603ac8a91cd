"""Adam in place against torch's own."""

from __future__ import annotations

import pytest
import torch

from fastsplat.service.splatting.optim import adam_update
from fastsplat.service.splatting.raster import Backend
from fastsplat.service.splatting.raster.cpu import instruction_sets
from fastsplat_contract.errors import InvalidInputError


@pytest.mark.parametrize("isa", [*instruction_sets(), "torch"])
@pytest.mark.parametrize("shape", [(1,), (37, 3), (20_001, 4)])
def test_many_steps_follow_torch(isa: str, shape: tuple[int, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    backend: Backend = "reference" if isa == "torch" else "cpu"
    if backend == "cpu":
        monkeypatch.setenv("FASTSPLAT_RASTER_ISA", isa)
    g = torch.Generator().manual_seed(0)
    value = torch.randn(*shape, generator=g)
    theirs = value.double().clone().requires_grad_()
    torchs = torch.optim.Adam([theirs], lr=1e-2, eps=1e-15)
    first, second = torch.zeros(shape), torch.zeros(shape)
    for step in range(1, 8):
        grad = torch.randn(*shape, generator=g) * 10.0 ** (step - 4)
        adam_update(value, grad, first, second, rate=1e-2, step=step, backend=backend)
        theirs.grad = grad.double()
        torchs.step()
    assert float((value - theirs.detach()).abs().max()) < 2e-6


def test_no_gradient_ever_means_no_step() -> None:
    value, zero = torch.ones(5), torch.zeros(5)
    adam_update(value, zero, torch.zeros(5), torch.zeros(5), rate=1.0, step=1)
    assert torch.equal(value, torch.ones(5))


def test_what_does_not_fit_is_refused() -> None:
    parts = [torch.zeros(4) for _ in range(4)]
    with pytest.raises(InvalidInputError):
        adam_update(*parts, rate=0.1, step=0)
    with pytest.raises(InvalidInputError):
        adam_update(parts[0].double(), *parts[1:], rate=0.1, step=1)
    with pytest.raises(InvalidInputError):
        adam_update(parts[0], parts[1][:2], *parts[2:], rate=0.1, step=1)
