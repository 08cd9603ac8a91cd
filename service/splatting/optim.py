"""Adam in one pass over memory, by the kernels' own threads."""

from __future__ import annotations

import torch
from torch import Tensor

from service.common.errors import InvalidInputError
from service.splatting.raster.cpu import instruction_set, kernels, thread_count


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
) -> None:
    """One step of Adam (Kingma & Ba 2015) on one tensor, in place; what `torch.optim.Adam` computes.

    Args:
        value: float32, contiguous, CPU, any shape; updated.
        grad: same shape.
        first: running mean of the gradient, same shape; updated.
        second: running mean of its square, same shape; updated.
        rate: learning rate.
        step: number of this step, from 1.
        betas: decay of the two means.
        epsilon: added to the root of `second`.

    Raises:
        InvalidInputError: another dtype, device or layout, shapes that differ, or a step below 1.
    """
    parts = {"value": value, "first": first, "second": second}
    for name, tensor in parts.items():
        if tensor.dtype != torch.float32 or tensor.device.type != "cpu" or not tensor.is_contiguous():
            raise InvalidInputError(f"{name} must be contiguous float32 on the CPU", field=name)
    if not value.shape == grad.shape == first.shape == second.shape:
        raise InvalidInputError("value, grad, first and second differ in shape", field="grad")
    if step < 1:
        raise InvalidInputError(f"step {step}", field="step", hint="Steps count from 1.")
    arrays = [value.detach().numpy(), grad.to(torch.float32).contiguous().numpy(), first.numpy(), second.numpy()]
    kernels.adam(*arrays, rate, *betas, epsilon, step, thread_count(), instruction_set())
