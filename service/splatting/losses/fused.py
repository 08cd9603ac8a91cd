"""Fused C++ losses: value and gradient in one pass, without H×W×N temporaries.

Inputs are float32 and contiguous; `codes` and `squared` may have any pixel stride.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fastsplat.service.splatting.losses.one_pass import StoredGradients
from fastsplat.service.splatting.raster.kernels import kernel_options, kernels

MAX_CODE_SIZE: int = kernels.MAX_CODE_SIZE
"""Largest code dimension that `SemanticLoss` supports."""


class ImageLoss(StoredGradients):
    """(image, target, ssim_weight, valid | None) -> scalar."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Tensor:
        image, target, ssim_weight, valid = inputs
        grad = torch.empty_like(image) if ctx.needs_input_grad[0] else None
        options = kernel_options()
        loss = kernels.image_loss(
            image=image.detach().numpy(),
            target=target.numpy(),
            valid=None if valid is None else valid.view(torch.uint8).numpy(),
            ssim_weight=float(ssim_weight),
            grad=None if grad is None else grad.numpy(),
            threads=options.threads,
            isa=options.isa,
        )
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
        options = kernel_options()
        loss = kernels.cross_entropy(
            codes=codes.numpy(),
            weight=weight.numpy(),
            bias=bias.numpy(),
            labels=labels.numpy(),
            class_weights=class_weights.numpy(),
            d_codes=d_codes.numpy(),
            d_weight=d_weight.numpy(),
            d_bias=d_bias.numpy(),
            threads=options.threads,
            isa=options.isa,
        )
        ctx.save_for_backward(d_codes, d_weight, d_bias)
        return torch.tensor(loss, dtype=torch.float32)


class SurfaceLoss(StoredGradients):
    """(alpha, depth, squared, target, valid | None, alpha_min, step, weights of spread, smoothness) -> scalar."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Tensor:
        alpha, depth, squared, target, valid, alpha_min, step, spread_weight, smoothness_weight = inputs
        gradients = [torch.empty(alpha.shape) for _ in range(3)]
        options = kernel_options()
        loss = kernels.surface_loss(
            alpha=alpha.detach().numpy(),
            depth=depth.detach().numpy(),
            squared=squared.detach().numpy(),
            target=target.numpy(),
            valid=None if valid is None else valid.view(torch.uint8).numpy(),
            alpha_min=alpha_min,
            step=step,
            spread_weight=spread_weight,
            smoothness_weight=smoothness_weight,
            d_alpha=gradients[0].numpy(),
            d_depth=gradients[1].numpy(),
            d_squared=gradients[2].numpy(),
            threads=options.threads,
            isa=options.isa,
        )
        ctx.save_for_backward(*gradients)
        return torch.tensor(loss, dtype=torch.float32)
