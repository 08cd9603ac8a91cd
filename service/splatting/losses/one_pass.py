"""float32 losses for any device: value and gradients in one torch pass, for GPUs."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fastsplat.service.splatting.losses.torch_losses import C1, C2, LOGIT_LIMIT, blur

_LOGITS = 1 << 24


class StoredGradients(torch.autograd.Function):
    """A scalar whose `forward` saves the gradients of its first inputs."""

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *grads: Any) -> tuple[Tensor | None, ...]:
        """Scales the stored gradients."""
        scaled = [gradient * grads[0] for gradient in ctx.saved_tensors]
        return (*scaled, *[None] * (len(ctx.needs_input_grad) - len(scaled)))


class ImageLoss(StoredGradients):
    """(image [H, W, 3], target, ssim_weight, valid | None) -> scalar; float32, one device."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Tensor:
        """With d SSIM = blur(∂μ) + 2x·blur(∂σ²) + y·blur(∂σxy), as the window is even."""
        image, target, ssim_weight, valid = inputs
        x, y = (part.detach().permute(2, 0, 1)[:, None] for part in (image, target))
        share: Tensor | float = 1.0 / max(x.numel(), 1)
        if valid is not None:
            mask = valid.to(x.dtype)
            share = mask / (3.0 * mask.sum()).clamp_min(1.0)
        mu_x, mu_y, square_x, square_y, product = blur(torch.cat((x, y, x * x, y * y, x * y))).chunk(5)
        mu_xy, mu_xx_yy = mu_x * mu_y, mu_x * mu_x + mu_y * mu_y
        a1, a2 = (2 * mu_xy).add_(C1), (product - mu_xy).mul_(2).add_(C2)
        b1, b2 = mu_xx_yy + C1, (square_x + square_y).sub_(mu_xx_yy).add_(C2)
        scale = (b1 * b2).reciprocal_()
        ssim, difference = a1 * a2 * scale, x - y
        loss: Tensor = (difference.abs().mul_(1.0 - ssim_weight).add_((1.0 - ssim).mul_(ssim_weight)) * share).sum()
        if ctx.needs_input_grad[0]:
            by_product, by_square = (2 * a1).mul_(scale), (ssim / b2).neg_()
            by_mean = (2 * mu_y).mul_(a2).mul_(scale).sub_((2 * mu_x * ssim).div_(b1))
            by_mean.sub_(mu_y * by_product).sub_((2 * mu_x).mul_(by_square))
            terms = torch.cat((by_mean, by_square, by_product)).reshape(3, 3, 1, *x.shape[2:])
            by_mean, by_square, by_product = blur((terms * share).flatten(0, 1)).chunk(3)
            slope = by_mean.addcmul(x, by_square, value=2.0).addcmul_(y, by_product).mul_(-ssim_weight)
            slope.add_((difference.sign_() * share).mul_(1.0 - ssim_weight))
            ctx.save_for_backward(slope[:, 0].permute(1, 2, 0))
        return loss


class SemanticLoss(StoredGradients):
    """(codes [P, D], weight, bias, labels int [P], class_weights) -> scalar; one dtype, one device."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Tensor:
        """The gradient of the logits is softmax − one-hot, weighted."""
        codes, weight, bias, labels, class_weights = (part.detach() for part in inputs)
        labels = labels.long()
        pixel_weights = class_weights.to(codes.dtype)[labels]
        total = pixel_weights.sum()
        shares = pixel_weights / torch.where(total > 0, total, 1.0)
        d_codes = torch.empty_like(codes)
        d_weight, d_bias = torch.zeros_like(weight), torch.zeros_like(bias)
        loss: Tensor = codes.new_zeros(())
        step = max(1, _LOGITS // len(bias))
        for start in range(0, len(codes), step):
            piece = slice(start, start + step)
            share, picked = shares[piece], labels[piece, None]
            logits = torch.addmm(bias, codes[piece], weight.T).clamp_(-LOGIT_LIMIT, LOGIT_LIMIT)
            log_p = torch.log_softmax(logits, dim=1)
            log_p_label = log_p.gather(1, picked)[:, 0]
            loss += (share * torch.where(share > 0, -log_p_label, 0.0)).sum()
            slope = log_p.exp_()
            slope.scatter_add_(1, picked, slope.new_full((1, 1), -1.0).expand(len(slope), 1))
            slope.mul_(share[:, None])
            d_codes[piece] = slope @ weight
            d_weight.addmm_(slope.T, codes[piece])
            d_bias += slope.sum(dim=0)
        ctx.save_for_backward(d_codes, d_weight, d_bias)
        return loss
