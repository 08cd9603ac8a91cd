"""The term of the loss for what a depth sensor measured, and its measurements at the size of a frame."""

from __future__ import annotations

import torch
from torch import Tensor

from fastsplat.service.splatting.raster.types import Rendering
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.splatting.training_views import Frame

_ALPHA_MIN = 0.1
"""Pixels less covered than this have no depth here."""


def sensor_depth_terms(rendering: Rendering, frame: Frame, settings: TrainingSettings) -> dict[str, Tensor]:
    """The weighted term of this module, by name; none for a frame without measurements or for a weight of 0.

    Args:
        rendering: alpha and depth of a frame.
        frame: what was measured of it.
        settings: the weight, and `depth_every`, by which it is multiplied because it enters only so often.
    """
    if frame.depth is None or not settings.sensor_depth_weight:
        return {}
    error = sensor_depth_error(rendering.alpha, rendering.depth, frame.depth, frame.valid)
    return {"sensor_depth": settings.sensor_depth_weight * settings.depth_every * error}


def sensor_depth_error(alpha: Tensor, depth: Tensor, measured: Tensor, valid: Tensor | None = None) -> Tensor:
    """Mean over the measured pixels of |ln(expected depth / measured depth)|; 0 where there is none.

    The logarithm counts errors in shares of the depth, as sensors make them, and the absolute value lets a few wrong
    measurements, at edges and on glass, pull no harder than right ones.

    Args:
        alpha: [H, W], Σ w.
        depth: [H, W], Σ w z.
        measured: [H, W] camera z, scene units; 0 where unknown.
        valid: bool [H, W], pixels that count; None where all do.
    """
    counts = (measured > 0) & (alpha.detach() > _ALPHA_MIN) & (depth.detach() > 0)
    if valid is not None:
        counts = counts & valid
    ratio = torch.where(counts, depth, 1.0) / torch.where(counts, alpha * measured, 1.0)
    return torch.where(counts, ratio.log().abs(), 0.0).sum() / counts.sum().clamp_min(1)
