"""The public losses: check once, then compute. float32 on the CPU goes to the fused kernels, anything else to torch.

Of what torch computes, the semantic loss in float32 (a GPU's) never builds the H×W×N logits either.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from fastsplat.service.splatting.losses import reference
from fastsplat_contract.errors import InvalidInputError


@dataclass(frozen=True)
class ImageTarget:
    """A training image at one resolution, with what of its SSIM never changes.

    Attributes:
        image: [H, W, 3], 0..1.
        valid: bool [H, W] or None; pixels that are False do not count.
    """

    image: Tensor
    valid: Tensor | None = None

    @cached_property
    def moments(self) -> tuple[Tensor, Tensor]:
        """Windowed mean and variance of a float32 image on the CPU, each [H, W, 3]."""
        from fastsplat.service.splatting.losses import cpu

        return cpu.target_moments(self.image)


def image_loss(image: Tensor, target: Tensor | ImageTarget, ssim_weight: float, valid: Tensor | None = None) -> Tensor:
    """(1 − λ)·|image − target| + λ·(1 − SSIM), mean over valid pixels and channels; 0 if none is valid.

    SSIM uses the 11×11 Gaussian window (σ 1.5), zero padding, C1 = 0.01², C2 = 0.03². The gradient flows to `image`.

    Args:
        image: [H, W, 3], 0..1.
        target: [H, W, 3] of the same dtype, or an `ImageTarget`, whose moments are computed once.
        ssim_weight: λ, 0..1.
        valid: bool [H, W]; not with an `ImageTarget`, which brings its own.

    Raises:
        InvalidInputError: shapes that do not fit.
    """
    if isinstance(target, Tensor):
        target = ImageTarget(target, valid)
    elif valid is not None:
        raise InvalidInputError("both an ImageTarget and a valid mask", field="valid")
    if image.ndim != 3 or image.shape[2] != 3 or image.shape != target.image.shape:
        raise InvalidInputError(
            f"image {tuple(image.shape)}, target {tuple(target.image.shape)}; both must be [H, W, 3]", field="image"
        )
    if target.valid is not None and target.valid.shape != image.shape[:2]:
        raise InvalidInputError(f"valid {tuple(target.valid.shape)} for {tuple(image.shape)}", field="valid")
    if not _fused(image, target.image):
        return reference.image_loss(image, target.image, ssim_weight, target.valid)
    from fastsplat.service.splatting.losses import cpu

    if not target.image.is_contiguous():
        target = ImageTarget(target.image.contiguous(), target.valid)
    valid = None if target.valid is None else target.valid.to(torch.bool).contiguous()
    loss: Tensor = cpu.ImageLoss.apply(  # type: ignore[no-untyped-call]
        image.contiguous(), target.image, *target.moments, valid, ssim_weight
    )
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
    if _fused(codes_image, weight, bias, class_weights) and 0 < codes_image.shape[2] <= _MAX_CODE:
        return _fused_semantic(codes_image, weight, bias, labels, class_weights)
    if labels.numel() and (int(labels.max()) >= classes or int(labels.min()) < 0):
        raise InvalidInputError(f"labels outside 0..{classes - 1}", field="labels")
    if not _single(codes_image, weight, bias, class_weights):
        return reference.semantic_loss(codes_image, weight, bias, labels, class_weights)
    from fastsplat.service.splatting.losses import chunked

    loss: Tensor = chunked.SemanticLoss.apply(  # type: ignore[no-untyped-call]
        codes_image.flatten(0, 1), weight, bias, labels.reshape(-1), class_weights
    )
    return loss


_MAX_CODE = 64


def _single(*tensors: Tensor) -> bool:
    return all(tensor.dtype == torch.float32 for tensor in tensors)


def _fused(*tensors: Tensor) -> bool:
    return _single(*tensors) and all(tensor.device.type == "cpu" for tensor in tensors)


def _fused_semantic(codes: Tensor, weight: Tensor, bias: Tensor, labels: Tensor, class_weights: Tensor) -> Tensor:
    from fastsplat.service.splatting.losses import cpu

    # A slice of an image's channels is read in place: one stride from pixel to pixel is all the kernel needs.
    size = codes.shape[2]
    even = codes.stride(2) == 1 and codes.stride(0) == codes.shape[1] * codes.stride(1)
    flat = (codes if even else codes.contiguous()).flatten(0, 1)
    if size == 1:
        flat = flat.contiguous()
    try:
        loss: Tensor = cpu.SemanticLoss.apply(  # type: ignore[no-untyped-call]
            flat,
            weight.contiguous(),
            bias.contiguous(),
            labels.reshape(-1).to(torch.int32).contiguous(),
            class_weights.detach().contiguous(),
        )
    except IndexError:
        raise InvalidInputError(f"labels outside 0..{weight.shape[0] - 1}", field="labels") from None
    return loss
