"""Fused losses of the C++ extension: value and gradient in one pass, nothing of size H×W×N ever built."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fastsplat.service.splatting.raster.cpu import instruction_set, kernels, thread_count


def target_moments(target: Tensor) -> tuple[Tensor, Tensor]:
    """Windowed mean and variance of a target [H, W, 3], float32."""
    mean, variance = torch.empty_like(target), torch.empty_like(target)
    kernels.target_moments(target.numpy(), mean.numpy(), variance.numpy(), thread_count(), instruction_set())
    return mean, variance


class ImageLoss(torch.autograd.Function):
    """(image, target, mean, variance, valid | None, ssim_weight) -> scalar; all float32 and contiguous."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Tensor:
        """Computes the gradient along with the value."""
        image, target, mean, variance, valid, ssim_weight = inputs
        wanted = ctx.needs_input_grad[0]
        grad = torch.empty_like(image) if wanted else None
        loss = kernels.image_loss(
            image.detach().numpy(),
            target.numpy(),
            mean.numpy(),
            variance.numpy(),
            None if valid is None else valid.view(torch.uint8).numpy(),
            float(ssim_weight),
            None if grad is None else grad.numpy(),
            thread_count(),
            instruction_set(),
        )
        if grad is not None:
            ctx.save_for_backward(grad)
        return torch.tensor(loss, dtype=torch.float32)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *grads: Any) -> tuple[Tensor | None, ...]:
        """Scales the stored gradient."""
        (grad,) = ctx.saved_tensors
        return grad * grads[0], None, None, None, None, None


class SemanticLoss(torch.autograd.Function):
    """(codes [P, D] any pixel stride, weight, bias, labels int32 [P], class_weights) -> scalar; float32."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Tensor:
        """Computes all gradients along with the value."""
        codes, weight, bias, labels, class_weights = inputs
        d_codes = torch.empty(codes.shape)
        d_weight, d_bias = torch.empty_like(weight), torch.empty_like(bias)
        loss = kernels.semantic_loss(
            *(part.detach().numpy() for part in (codes, weight, bias, labels, class_weights)),
            *(part.numpy() for part in (d_codes, d_weight, d_bias)),
            thread_count(),
            instruction_set(),
        )
        ctx.save_for_backward(d_codes, d_weight, d_bias)
        return torch.tensor(loss, dtype=torch.float32)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *grads: Any) -> tuple[Tensor | None, ...]:
        """Scales the stored gradients."""
        d_codes, d_weight, d_bias = ctx.saved_tensors
        return d_codes * grads[0], d_weight * grads[0], d_bias * grads[0], None, None
