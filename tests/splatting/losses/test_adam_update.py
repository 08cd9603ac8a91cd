"""Adam in place against torch's own."""

from __future__ import annotations

import pytest
import torch

from fastsplat.service.splatting.optim import adam_update
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat.service.splatting.raster.kernels import instruction_sets, running_with
from fastsplat_contract.errors import InvalidInputError


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
