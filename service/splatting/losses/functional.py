"""Public losses: validates arguments, then dispatches by dtype and device.

float32 uses fused C++ kernels on the CPU and one pass of torch elsewhere; other dtypes use plain torch.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from fastsplat.service.splatting.losses import one_pass, torch_losses
from fastsplat_contract.errors import InvalidInputError

_LARGEST = 1e18
"""Limit of codes and weights: products, and their sums over an image, fit float32."""
_BRIGHTEST = 1e9
"""Limit of colors: products of four, as in SSIM, fit float32."""


def image_loss(image: Tensor, target: Tensor, ssim_weight: float, valid: Tensor | None = None) -> Tensor:
    """Computes (1 − λ)·L1 + λ·(1 − SSIM), mean over valid pixels and channels.

    SSIM uses an 11×11 Gaussian window (σ 1.5), zero padding, C1 = 0.01², C2 = 0.03², and also reads invalid pixels. The
    gradient flows to `image`. 0 if no pixel is valid.

    Args:
        image, target: [H, W, 3], 0..1, not empty, of one dtype.
        ssim_weight: λ, 0..1.
        valid: bool [H, W]; None means all.

    Raises:
        InvalidInputError: shapes do not match, or colors are not finite or so large that the loss is not.

    >>> image_loss(torch.ones(2, 4, 3), torch.zeros(2, 4, 3), ssim_weight=0.0)
    tensor(1.)
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.shape != target.shape or not image.numel():
        raise InvalidInputError(
            f"image {tuple(image.shape)}, target {tuple(target.shape)}; both must be [H, W, 3] and not empty",
            field="image",
        )
    if valid is not None and valid.shape != image.shape[:2]:
        raise InvalidInputError(f"valid {tuple(valid.shape)} for {tuple(image.shape)}", field="valid")
    way: Any = one_pass.ImageLoss.apply if _single(image, target) else torch_losses.image_loss
    if _fused(image, target):
        from fastsplat.service.splatting.losses import fused

        way, image, target = fused.ImageLoss.apply, image.contiguous(), target.contiguous()
        valid = None if valid is None else valid.to(torch.bool).contiguous()
    loss: Tensor = way(image, target, ssim_weight, valid)
    if not math.isfinite(loss.item()):
        field = "target" if _within(image, _BRIGHTEST) else "image"
        _check(False, field, f"±{_BRIGHTEST:g}")
    return loss


def semantic_loss(codes_image: Tensor, weight: Tensor, bias: Tensor, labels: Tensor, class_weights: Tensor) -> Tensor:
    """Computes Σ_p w[label]·CE(codes·Wᵀ + b, label) / Σ_p w[label], 0 without weight.

    Gradients: codes, weight, bias.

    Args:
        codes_image: [H, W, D], not empty.
        weight: [N + 1, D]; row 0 is the undetected class.
        bias: [N + 1].
        labels: integers [H, W], 0..N.
        class_weights: [N + 1], >= 0; 0 ignores that class's pixels, whatever their codes.

    Raises:
        InvalidInputError: shapes do not match, a label is above N, the bias is not finite, or another used value is
            beyond 1e18.

    >>> labels, weights = torch.ones(2, 4, dtype=torch.int32), torch.tensor([0.0, 1.0])
    >>> semantic_loss(torch.zeros(2, 4, 3), torch.zeros(2, 3), torch.zeros(2), labels, weights)  # log 2
    tensor(0.6931)
    """
    fits = (
        codes_image.ndim == 3
        and codes_image.numel() > 0
        and weight.ndim == 2
        and weight.shape[1] == codes_image.shape[2]
        and bias.shape == class_weights.shape == weight.shape[:1]
        and labels.shape == codes_image.shape[:2]
    )
    if not fits:
        raise InvalidInputError(
            f"codes {tuple(codes_image.shape)}, weight {tuple(weight.shape)}, bias {tuple(bias.shape)}, "
            f"labels {tuple(labels.shape)}, class_weights {tuple(class_weights.shape)}",
            field="codes_image",
        )
    labels = labels.to(torch.int32)
    codes_image = _counted_codes(codes_image, weight, bias, labels, class_weights)
    if not _single(codes_image, weight, bias, class_weights):
        return torch_losses.semantic_loss(codes_image, weight, bias, labels, class_weights)
    way: Any = one_pass.SemanticLoss
    if _fused(codes_image, weight, bias, class_weights):
        from fastsplat.service.splatting.losses import fused

        if codes_image.shape[2] <= fused.MAX_CODE_SIZE:
            # The kernel reads channel slices in place if the pixel stride is uniform.
            even = codes_image.stride(2) == 1 and codes_image.stride(0) == codes_image.shape[1] * codes_image.stride(1)
            way = fused.SemanticLoss
            codes_image = codes_image if even and codes_image.shape[2] > 1 else codes_image.contiguous()
            weight, bias, class_weights = weight.contiguous(), bias.contiguous(), class_weights.detach().contiguous()
    loss: Tensor = way.apply(codes_image.flatten(0, 1), weight, bias, labels.reshape(-1).contiguous(), class_weights)
    return loss


def _counted_codes(codes: Tensor, weight: Tensor, bias: Tensor, labels: Tensor, class_weights: Tensor) -> Tensor:
    """Validates all arguments; returns codes with out-of-range ones of weight 0 zeroed."""
    parts = (codes, labels, weight, bias, class_weights)
    # One transfer, because each waits for the GPU.
    bounds = torch.stack([bound.double() for part in parts for bound in part.detach().aminmax()]).tolist()
    largest = [max(-least, most) for least, most in zip(bounds[::2], bounds[1::2], strict=True)]
    if bounds[2] < 0 or bounds[3] >= len(bias):
        raise InvalidInputError(f"labels outside 0..{len(bias) - 1}", field="labels")
    _check(largest[2] <= _LARGEST, "weight", f"±{_LARGEST:g}")
    _check(largest[3] < math.inf, "bias", "the finite numbers")
    _check(0 <= bounds[8] <= bounds[9] <= _LARGEST, "class_weights", f"0 to {_LARGEST:g}")
    if not largest[0] <= _LARGEST:
        codes = torch.where((class_weights[labels] > 0)[..., None], codes, 0.0)
        _check(_within(codes, _LARGEST), "codes_image", f"±{_LARGEST:g}")
    return codes


def _within(values: Tensor, limit: float) -> bool:
    return bool((values.detach().abs() <= limit).all())


def _check(fits: bool, field: str, limit: str) -> None:
    if not fits:
        raise InvalidInputError(f"{field} has numbers beyond {limit}: no loss is finite", field=field, limit=limit)


def _single(*tensors: Tensor) -> bool:
    return all(tensor.dtype == torch.float32 for tensor in tensors)


def _fused(*tensors: Tensor) -> bool:
    return _single(*tensors) and all(tensor.device.type == "cpu" for tensor in tensors)
