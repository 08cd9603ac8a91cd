"""Adam: on the CPU in one pass over memory, by the kernels' own threads; elsewhere by torch."""

from __future__ import annotations

import torch
from torch import Tensor

from fastsplat.service.splatting.raster import Backend
from fastsplat_contract.errors import InvalidInputError


@torch.no_grad()
def adam_update(
    value: Tensor,
    grad: Tensor,
    first: Tensor,
    second: Tensor,
    *,
    rate: float,
    step: int,
    betas: tuple[float, float] = (0.9, 0.999),
    epsilon: float = 1e-15,
    backend: Backend = "cpu",
) -> None:
    """One step of Adam (Kingma & Ba 2015) on one tensor, in place; what `torch.optim.Adam` computes.

    Args:
        value: float32, contiguous, any shape; updated.
        grad: same shape.
        first: running mean of the gradient, same shape; updated.
        second: running mean of its square, same shape; updated.
        rate: learning rate.
        step: number of this step, from 1.
        betas: decay of the two means.
        epsilon: added to the root of `second`.
        backend: `cpu` uses the kernels and wants CPU tensors, the others torch on the tensors' device.

    Raises:
        InvalidInputError: another dtype, device or layout, shapes that differ, or a step below 1.
    """
    parts = {"value": value, "first": first, "second": second}
    for name, tensor in parts.items():
        if tensor.dtype != torch.float32 or not tensor.is_contiguous():
            raise InvalidInputError(f"{name} must be contiguous float32", field=name)
        if tensor.device != value.device or (backend == "cpu" and tensor.device.type != "cpu"):
            raise InvalidInputError(f"{name} is on {tensor.device} (backend {backend})", field=name)
    if not value.shape == grad.shape == first.shape == second.shape:
        raise InvalidInputError("value, grad, first and second differ in shape", field="grad")
    if step < 1:
        raise InvalidInputError(f"step {step}", field="step", hint="Steps count from 1.")
    if backend != "cpu":
        _by_torch(value, grad.to(torch.float32), first, second, rate, step, betas, epsilon)
        return
    from fastsplat.service.splatting.raster.cpu import instruction_set, kernels, thread_count

    arrays = [value.detach().numpy(), grad.to(torch.float32).contiguous().numpy(), first.numpy(), second.numpy()]
    kernels.adam(*arrays, rate, *betas, epsilon, step, thread_count(), instruction_set())


def _by_torch(
    value: Tensor,
    grad: Tensor,
    first: Tensor,
    second: Tensor,
    rate: float,
    step: int,
    betas: tuple[float, float],
    epsilon: float,
) -> None:
    first.mul_(betas[0]).add_(grad, alpha=1 - betas[0])
    second.mul_(betas[1]).addcmul_(grad, grad, value=1 - betas[1])
    divisor = second.sqrt().div_((1 - betas[1] ** step) ** 0.5).add_(epsilon)
    value.addcdiv_(first, divisor, value=-rate / (1 - betas[0] ** step))
