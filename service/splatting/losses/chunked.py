"""The semantic loss on any device: value and gradients in one pass over pieces of the image, H×W×N never built."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fastsplat.service.splatting.losses.torch_losses import LOGIT_LIMIT

_LOGITS = 1 << 24


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
