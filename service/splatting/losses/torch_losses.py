"""Autograd versions of the fused losses for any float dtype."""

from __future__ import annotations

from functools import cache

import torch
from torch import Tensor

WINDOW = 11
SIGMA = 1.5
C1 = 0.01**2
C2 = 0.03**2
LOGIT_LIMIT = 1e30
_CPU = torch.device("cpu")


@cache  # avoids a transfer to the GPU in each step
def window(dtype: torch.dtype, device: torch.device = _CPU) -> Tensor:
    """SSIM window (Wang et al. 2004), [11]: σ = 1.5 pixels, sum 1. Read-only."""
    offsets = torch.arange(WINDOW, dtype=torch.float64) - WINDOW // 2
    weights = torch.exp(-0.5 * (offsets / SIGMA) ** 2)
    return (weights / weights.sum()).to(device, dtype)


def blur(image: Tensor) -> Tensor:
    """Blurs [B, 1, H, W] by the separable window with zero padding."""
    # Both passes run along rows, which a GPU convolves faster.
    taps = window(image.dtype, image.device).reshape(1, 1, 1, -1)
    for _ in range(2):
        image = torch.nn.functional.conv2d(image, taps, padding=(0, WINDOW // 2)).transpose(2, 3).contiguous()
    return image


def ssim_map(image: Tensor, target: Tensor) -> Tensor:
    """Structural similarity per pixel and channel, [H, W, 3] (Wang et al. 2004, equation 13)."""
    x, y = image.permute(2, 0, 1)[:, None], target.permute(2, 0, 1)[:, None]
    mu_x, mu_y, square_x, square_y, product = blur(torch.cat((x, y, x * x, y * y, x * y))).chunk(5)
    var_x, var_y, cov = square_x - mu_x**2, square_y - mu_y**2, product - mu_x * mu_y
    numerator = (2 * mu_x * mu_y + C1) * (2 * cov + C2)
    denominator = (mu_x**2 + mu_y**2 + C1) * (var_x + var_y + C2)
    return (numerator / denominator)[:, 0].permute(1, 2, 0)


def image_loss(image: Tensor, target: Tensor, ssim_weight: float, valid: Tensor | None) -> Tensor:
    loss = (1.0 - ssim_weight) * (image - target).abs() + ssim_weight * (1.0 - ssim_map(image, target))
    if valid is None:
        return loss.mean()
    mask = valid.to(loss.dtype)[:, :, None]
    return (loss * mask).sum() / (3.0 * mask.sum()).clamp_min(1.0)


def semantic_loss(codes: Tensor, weight: Tensor, bias: Tensor, labels: Tensor, class_weights: Tensor) -> Tensor:
    logits = codes.reshape(-1, codes.shape[-1]) @ weight.T + bias
    # Clamped to ±1e30, so that differences and sums over an image stay finite in float32.
    fixed = logits.detach()
    shifted = fixed.clamp(-LOGIT_LIMIT, LOGIT_LIMIT) + torch.where(torch.isfinite(fixed), logits - fixed, 0.0)
    top = shifted.detach().amax(dim=1, keepdim=True)
    log_p = shifted - top - torch.exp(shifted - top).sum(dim=1, keepdim=True).log()
    picked = labels.reshape(-1, 1).long()
    pixel_weights = class_weights.to(logits.dtype)[picked[:, 0]]
    total = pixel_weights.sum()
    return (pixel_weights * -log_p.gather(1, picked)[:, 0]).sum() / torch.where(total > 0, total, 1.0)
