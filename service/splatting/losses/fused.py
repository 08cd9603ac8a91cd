"""Fused C++ losses: value and gradient in one pass, without H×W×N temporaries.

Inputs are float32 and contiguous; `codes` and `squared` may have any pixel stride.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fastsplat.service.splatting.losses.one_pass import StoredGradients
from fastsplat.service.splatting.raster.kernels import arrays, kernels, running

MAX_CODE_SIZE: int = kernels.MAX_CODE_SIZE
"""Largest code dimension that `SemanticLoss` supports."""


class ImageLoss(StoredGradients):
    """(image, target, ssim_weight, valid | None) -> scalar."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Tensor:
        image, target, ssim_weight, valid = inputs
        grad = torch.empty_like(image) if ctx.needs_input_grad[0] else None
        given = arrays(image=image, target=target, valid=valid, grad=grad)
        loss = kernels.image_loss(**given, ssim_weight=float(ssim_weight), **running())
        if grad is not None:
            ctx.save_for_backward(grad)
        return torch.tensor(loss, dtype=torch.float32)


class SemanticLoss(StoredGradients):
    """(codes [P, D], weight, bias, labels int32 [P], class_weights) -> scalar."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Tensor:
        codes, weight, bias, labels, class_weights = (part.detach() for part in inputs)
        d_codes = torch.empty(codes.shape)
        d_weight, d_bias = torch.empty_like(weight), torch.empty_like(bias)
        given = arrays(codes=codes, weight=weight, bias=bias, labels=labels, class_weights=class_weights)
        loss = kernels.cross_entropy(**given, **arrays(d_codes=d_codes, d_weight=d_weight, d_bias=d_bias), **running())
        ctx.save_for_backward(d_codes, d_weight, d_bias)
        return torch.tensor(loss, dtype=torch.float32)


class SurfaceLoss(StoredGradients):
    """(alpha, depth, squared, target, valid | None, alpha_min, step, weights of spread, smoothness) -> scalar."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Tensor:
        alpha, depth, squared, target, valid, alpha_min, step, spread_weight, smoothness_weight = inputs
        d_alpha, d_depth, d_squared = gradients = [torch.empty(alpha.shape) for _ in range(3)]
        loss = kernels.surface_loss(
            **arrays(alpha=alpha, depth=depth, squared=squared, target=target, valid=valid),
            **arrays(d_alpha=d_alpha, d_depth=d_depth, d_squared=d_squared),
            alpha_min=alpha_min,
            step=step,
            spread_weight=spread_weight,
            smoothness_weight=smoothness_weight,
            **running(),
        )
        ctx.save_for_backward(*gradients)
        return torch.tensor(loss, dtype=torch.float32)
