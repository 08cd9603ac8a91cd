"""Exposure and white balance of single photos, by which a rendered picture is corrected before it is compared.

A correction is an exposure (EV, base 2) and the white balance of red and blue against green (EV): light is multiplied
by 2^(exposure + red), 2^exposure and 2^(exposure + blue), as in PPISP (Deutsch et al., CVPR 2026). With the curve of
sRGB (IEC 61966-2-1) a gain g of the light is, above the curve's toe, s ↦ k·(s + 0.055) − 0.055 of the stored value, k =
g^(1/2.4). The mean over the photos is zero after every step, since all photos darker and the scene brighter is the same
picture.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

_TOE = 0.04045  # of the sRGB curve, stored values
_SLOPE, _OFFSET, _EXPONENT = 12.92, 0.055, 2.4
SATURATED = 254 / 255
"""A photo says of a channel from here on only that it is at least as bright."""
_DARK = 12 / 255
"""Below, the steps of 8 bits are coarse in light."""
_STRIDE, _MIN_PIXELS = 2, 100


def to_light(stored: Tensor) -> Tensor:
    """Linear light of sRGB values (IEC 61966-2-1), any shape; negative values and those above 1 are continued."""
    bright = ((stored.clamp_min(_TOE) + _OFFSET) / (1 + _OFFSET)) ** _EXPONENT
    return torch.where(stored <= _TOE, stored / _SLOPE, bright)


def from_light(light: Tensor) -> Tensor:
    """The inverse of `to_light`."""
    bright = (1 + _OFFSET) * light.clamp_min(_TOE / _SLOPE) ** (1 / _EXPONENT) - _OFFSET
    return torch.where(light <= _TOE / _SLOPE, light * _SLOPE, bright)


def channel_evs(correction: Tensor) -> Tensor:
    """[..., 3] EV of red, green and blue of corrections [..., 3] (exposure, red, blue)."""
    exposure, red, blue = correction.unbind(-1)
    return torch.stack([exposure + red, exposure, exposure + blue], dim=-1)


def correct(image: Tensor, correction: Tensor) -> Tensor:
    """A picture [..., P, 3] of sRGB values, which may lie outside of 0..1, as a photo of that correction [3], EV, shows
    it; differentiable in both. Zeros change nothing."""
    corrected: Tensor = _Exposed.apply(image, channel_evs(correction))  # type: ignore[no-untyped-call]
    return corrected


def corrected_for(image: Tensor, correction: Tensor, target: Tensor) -> Tensor:
    """`correct`, but no brighter than the photo `target` [..., 3] where that is saturated."""
    corrected = correct(image, correction)
    return torch.where((target >= SATURATED) & (corrected > target), target, corrected)


def zero_mean(corrections: Tensor) -> Tensor:
    """The corrections [V, 3] without their mean over the photos."""
    values = corrections.double()
    return (values - values.mean(dim=0)).to(corrections.dtype)


@torch.no_grad()
def fitted_correction(image: Tensor, target: Tensor, alpha: Tensor, valid: Tensor | None) -> Tensor | None:
    """[3]: the correction by which a picture has the photo's light in the median of the pixels, exposure, red, blue in
    EV; None where fewer than 100 pixels can tell.

    Medians forgive what the picture does not have yet, and what is before it in this photo alone.

    Args:
        image, target: [H, W, 3], rendered and not corrected, and the photo.
        alpha: [H, W], how far the scene covers the pixels; those half covered and more count.
        valid: bool [H, W], pixels of the photo that count; None where all do.
    """
    rows = slice(None, None, _STRIDE)
    image, target, alpha = image[rows, rows], target[rows, rows], alpha[rows, rows]
    usable = ((target > _DARK) & (target < SATURATED) & (image > _DARK)).all(dim=2) & (alpha > 0.5)
    if valid is not None:
        usable &= valid[rows, rows]
    if int(usable.sum()) < _MIN_PIXELS:
        return None
    red, green, blue = torch.log2(to_light(target[usable]) / to_light(image[usable])).median(dim=0).values
    return torch.stack([green, red - green, blue - green])


class _Exposed(torch.autograd.Function):
    """sRGB values [..., 3] times 2^evs [3] as light; rows of values, since torch multiplies single channels slowly."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, evs: Tensor) -> Tensor:
        rows = image.reshape(-1, 3 * image.shape[-2])
        gains = torch.exp2(evs).repeat(image.shape[-2])
        factors = gains ** (1 / _EXPONENT)
        exposed = torch.addcmul(_OFFSET * (factors - 1), rows, factors)
        dark = torch.nonzero(torch.minimum(rows, exposed).reshape(-1) < _TOE)[:, 0]
        source, gain = rows.reshape(-1)[dark], gains[dark % len(gains)]
        exposed.view(-1)[dark] = from_light(to_light(source) * gain)
        ctx.save_for_backward(gains, dark, source, gain, exposed)
        return exposed.reshape(image.shape)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, Tensor | None]:
        gains, dark, source, gain, exposed = ctx.saved_tensors
        gradient = gradients[0].reshape(exposed.shape)
        out, by_dark = exposed.view(-1)[dark], gradient.reshape(-1)[dark]
        by_image = by_evs = None
        if ctx.needs_input_grad[0]:
            by_image = gradient * gains ** (1 / _EXPONENT)
            by_image.view(-1)[dark] = by_dark * gain * _curve_slope(source) / _curve_slope(out)
            by_image = by_image.reshape(gradients[0].shape)
        if ctx.needs_input_grad[1]:
            # d stored / d EV = ln 2 · light · d stored / d light, which above the toe is ln 2 / 2.4 · (stored + 0.055).
            slopes = (exposed + _OFFSET) / _EXPONENT
            slopes.view(-1)[dark] = torch.where(out <= _TOE, out, (out + _OFFSET) / _EXPONENT)
            by_evs = math.log(2) * (gradient * slopes).sum(dim=0).reshape(-1, 3).sum(dim=0)
        return by_image, by_evs


def _curve_slope(stored: Tensor) -> Tensor:
    """d light / d stored."""
    base = (stored.clamp_min(_TOE) + _OFFSET) / (1 + _OFFSET)
    bright = _EXPONENT / (1 + _OFFSET) * base ** (_EXPONENT - 1)
    return torch.where(stored <= _TOE, torch.full_like(stored, 1 / _SLOPE), bright)
