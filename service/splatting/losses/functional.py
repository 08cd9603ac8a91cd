"""The public losses: arguments are checked once, then fused kernels compute what is float32 on the CPU, and torch the
rest.

Of what torch computes, the semantic loss in float32 (a GPU's) never builds the H×W×N logits either.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fastsplat.service.splatting.losses import torch_losses
from fastsplat.service.splatting.losses.torch_losses import LOGIT_LIMIT
from fastsplat_contract.errors import InvalidInputError

_LOGITS = 1 << 24


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
    if not _fused(image, target):
        return torch_losses.image_loss(image, target, ssim_weight, valid)
    from fastsplat.service.splatting.losses import fused

    valid = None if valid is None else valid.to(torch.bool).contiguous()
    loss: Tensor = fused.ImageLoss.apply(image.contiguous(), target.contiguous(), valid, ssim_weight)  # type: ignore[no-untyped-call]
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
    if labels.numel() and (int(labels.max()) >= classes or int(labels.min()) < 0):
        raise InvalidInputError(f"labels outside 0..{classes - 1}", field="labels")
    if not _single(codes_image, weight, bias, class_weights):
        return torch_losses.semantic_loss(codes_image, weight, bias, labels, class_weights)
    from fastsplat.service.splatting.losses import chunked

    loss: Tensor = chunked.SemanticLoss.apply(  # type: ignore[no-untyped-call]
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


class SemanticLoss(torch.autograd.Function):
    """(codes [P, D], weight, bias, labels int [P], class_weights) -> scalar; one float dtype, one device."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Tensor:
        """Computes all gradients along with the value: softmax − one-hot, weighted."""
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
            logits = (
                torch.addmm(bias, codes[piece], weight.T).nan_to_num_(-LOGIT_LIMIT).clamp_(-LOGIT_LIMIT, LOGIT_LIMIT)
            )
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

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *grads: Any) -> tuple[Tensor | None, ...]:
        """Scales the stored gradients."""
        d_codes, d_weight, d_bias = ctx.saved_tensors
        return d_codes * grads[0], d_weight * grads[0], d_bias * grads[0], None, None
