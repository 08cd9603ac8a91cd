"""How near a picture is to the truth: PSNR and SSIM over valid pixels."""

from __future__ import annotations

import math

from torch import Tensor

from fastsplat.service.splatting.losses import image_loss


def psnr(image: Tensor, target: Tensor, valid: Tensor | None = None) -> float:
    """Peak signal-to-noise ratio in dB of [H, W, 3] pictures in 0..1 over `valid` pixels [H, W].

    The picture is clamped to 0..1 first. inf when equal, NaN when no pixel is valid.
    """
    error = (image.clamp(0, 1) - target) ** 2
    mse = float((error if valid is None else error[valid]).double().mean())
    return math.inf if mse == 0 else -10 * math.log10(mse)


def ssim(image: Tensor, target: Tensor, valid: Tensor | None = None) -> float:
    """Structural similarity (Wang et al. 2004) of [H, W, 3] pictures in 0..1, mean over `valid` pixels [H, W].

    Window and padding are those of the training loss (and of 3DGS): 11×11, σ = 1.5, zeros outside. NaN when no pixel
    is valid.
    """
    if valid is not None and not bool(valid.any()):
        return math.nan
    return 1 - float(image_loss(image.clamp(0, 1), target, 1.0, valid))
