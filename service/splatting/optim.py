"""Adam in one pass over memory: C++ kernel on the CPU, torch's fused kernel elsewhere."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.optim.adam import adam

from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat_contract.errors import InvalidInputError

_BETA1, _BETA2 = 0.9, 0.999
_EPS = 1e-15  # added to the root of `exp_avg_sq`


@torch.no_grad()
def adam_update(
    param: Tensor, grad: Tensor, exp_avg: Tensor, exp_avg_sq: Tensor, *, lr: float, step: int, backend: Backend = "cpu"
) -> None:
    """Performs one in-place Adam step (Kingma & Ba 2015), as `torch.optim.Adam`.

    `param` and the running means `exp_avg` (gradient) and `exp_avg_sq` (its square) are contiguous float32 of one
    shape.

    Args:
        step: from 1.
        backend: `cpu` uses the C++ kernel, the others torch on the tensors' device.

    Raises:
        InvalidInputError: wrong dtype, device, layout or shape, or a step below 1.
    """
    parts = {"param": param, "exp_avg": exp_avg, "exp_avg_sq": exp_avg_sq}
    for name, tensor in parts.items():
        if tensor.dtype != torch.float32 or not tensor.is_contiguous():
            raise InvalidInputError(f"{name} must be contiguous float32", field=name)
        if tensor.device != param.device or (backend == "cpu" and tensor.device.type != "cpu"):
            raise InvalidInputError(f"{name} is on {tensor.device} (backend {backend})", field=name)
    if not param.shape == grad.shape == exp_avg.shape == exp_avg_sq.shape:
        raise InvalidInputError("param, grad, exp_avg and exp_avg_sq differ in shape", field="grad")
    if step < 1:
        raise InvalidInputError(f"step {step}", field="step", hint="Steps count from 1.")
    grad = grad.to(torch.float32)
    if backend != "cpu":
        before = torch.full((), float(step - 1), device=param.device)
        adam(
            [param], [grad], [exp_avg], [exp_avg_sq], [], [before], fused=True,
            amsgrad=False, beta1=_BETA1, beta2=_BETA2, lr=lr, weight_decay=0.0, eps=_EPS, maximize=False,
        )  # fmt: skip
        return
    from fastsplat.service.splatting.raster.kernels import arrays, kernels, running

    given = arrays(param=param, grad=grad.contiguous(), exp_avg=exp_avg, exp_avg_sq=exp_avg_sq)
    kernels.adam(**given, lr=lr, beta1=_BETA1, beta2=_BETA2, eps=_EPS, step=step, **running())
