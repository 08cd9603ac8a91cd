"""The public losses: arguments are checked once; float32 on the CPU is computed by fused kernels, elsewhere in one pass
of torch, and other types by torch."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fastsplat.service.splatting.losses import one_pass, torch_losses
from fastsplat_contract.errors import InvalidInputError


def image_loss(image: Tensor, target: Tensor, ssim_weight: float, valid: Tensor | None = None) -> Tensor:
    """(1 − λ)·|image − target| + λ·(1 − SSIM), mean over valid pixels and channels; 0 if none is valid.

    SSIM uses the 11×11 Gaussian window (σ 1.5), zero padding, C1 = 0.01², C2 = 0.03². The gradient flows to `image`.

    Args:
        image: [H, W, 3], 0..1.
        target: [H, W, 3], 0..1, of the same dtype.
        ssim_weight: λ, 0..1.
        valid: bool [H, W], or None where every pixel counts.

    Raises:
        InvalidInputError: shapes that do not fit.
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.shape != target.shape:
        raise InvalidInputError(
            f"image {tuple(image.shape)}, target {tuple(target.shape)}; both must be [H, W, 3]", field="image"
        )
    if valid is not None and valid.shape != image.shape[:2]:
        raise InvalidInputError(f"valid {tuple(valid.shape)} for {tuple(image.shape)}", field="valid")
    if not _single(image, target):
        return torch_losses.image_loss(image, target, ssim_weight, valid)
    way: Any = one_pass.ImageLoss
    if _fused(image, target):
        from fastsplat.service.splatting.losses import fused

        way, image, target = fused.ImageLoss, image.contiguous(), target.contiguous()
        valid = None if valid is None else valid.to(torch.bool).contiguous()
    loss: Tensor = way.apply(image, target, valid, ssim_weight)
    return loss


def semantic_loss(codes_image: Tensor, weight: Tensor, bias: Tensor, labels: Tensor, class_weights: Tensor) -> Tensor:
    """Σ_p w[label]·CE(codes·Wᵀ + b, label) / Σ_p w[label]; 0 if that sum is 0. Gradients: codes, weight, bias.

    Args:
        codes_image: [H, W, D].
        weight: [N + 1, D]; row 0 is the undetected class.
        bias: [N + 1].
        labels: integers [H, W], 0..N.
        class_weights: [N + 1], >= 0; a weight of 0 ignores that class's pixels.

    Raises:
        InvalidInputError: shapes that do not fit, or a label above N.
    """
    classes = weight.shape[0]
    fits = (
        codes_image.ndim == 3
        and weight.ndim == 2
        and weight.shape[1] == codes_image.shape[2]
        and bias.shape == class_weights.shape == (classes,)
        and labels.shape == codes_image.shape[:2]
    )
    if not fits:
        raise InvalidInputError(
            f"codes {tuple(codes_image.shape)}, weight {tuple(weight.shape)}, bias {tuple(bias.shape)}, "
            f"labels {tuple(labels.shape)}, class_weights {tuple(class_weights.shape)}",
            field="codes_image",
        )
    if _fused(codes_image, weight, bias, class_weights) and codes_image.shape[2] > 0:
        from fastsplat.service.splatting.losses import fused

        if codes_image.shape[2] <= fused.MAX_CODE_SIZE:
            return _fused_semantic(codes_image, weight, bias, labels, class_weights)
    least, most = torch.stack(labels.aminmax()).tolist() if labels.numel() else (0, 0)
    if least < 0 or most >= classes:
        raise InvalidInputError(f"labels outside 0..{classes - 1}", field="labels")
    if not _single(codes_image, weight, bias, class_weights):
        return torch_losses.semantic_loss(codes_image, weight, bias, labels, class_weights)
    loss: Tensor = one_pass.SemanticLoss.apply(  # type: ignore[no-untyped-call]
        codes_image.flatten(0, 1), weight, bias, labels.reshape(-1), class_weights
    )
    return loss


def _single(*tensors: Tensor) -> bool:
    return all(tensor.dtype == torch.float32 for tensor in tensors)


def _fused(*tensors: Tensor) -> bool:
    return _single(*tensors) and all(tensor.device.type == "cpu" for tensor in tensors)


def _fused_semantic(codes: Tensor, weight: Tensor, bias: Tensor, labels: Tensor, class_weights: Tensor) -> Tensor:
    from fastsplat.service.splatting.losses import fused

    # A slice of an image's channels is read in place: one stride from pixel to pixel is all the kernel needs.
    size = codes.shape[2]
    even = codes.stride(2) == 1 and codes.stride(0) == codes.shape[1] * codes.stride(1)
    flat = (codes if even else codes.contiguous()).flatten(0, 1)
    if size == 1:
        flat = flat.contiguous()
    try:
        loss: Tensor = fused.SemanticLoss.apply(  # type: ignore[no-untyped-call]
            flat,
            weight.contiguous(),
            bias.contiguous(),
            labels.reshape(-1).to(torch.int32).contiguous(),
            class_weights.detach().contiguous(),
        )
    except IndexError:
        raise InvalidInputError(f"labels outside 0..{weight.shape[0] - 1}", field="labels") from None
    return loss
