"""Training objective: renders a view from parameters and computes its loss terms."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from fastsplat.service.splatting.exposure.photometric import corrected_for
from fastsplat.service.splatting.labels.semantics import label_loss
from fastsplat.service.splatting.losses.functional import image_loss
from fastsplat.service.splatting.raster.image_formation import Rendering, Splats
from fastsplat.service.splatting.training.depth_regularization import DepthAnchors, depth_terms
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat.service.splatting.training_views import Frame

_ALPHA_MIN = 0.1  # pixels with less alpha have no depth
_OPACITY_DECAY = 0.02  # weight of the mean opacity (3DGS-MCMC), so that useless Gaussians die
_SCALE_DECAY = 0.01  # weight of the mean scale relative to the scene's extent


def loss_terms(
    rendering: Rendering,  # of `render_frame`, with codes unless `class_weights` is None
    splats: Splats,
    parameters: Mapping[str, Tensor],
    frame: Frame,
    target: Tensor,  # [H, W, 3], the frame's image
    class_weights: Tensor | None,  # [N + 1], or None for no cross-entropy
    extent: float,  # of the scene, scene units
    settings: TrainingSettings,
    anchors: DepthAnchors | None = None,  # enables depth terms; `rendering` then has squared depth last
    correction: Tensor | None = None,  # [3] of the photo (`photometric`)
) -> dict[str, Tensor]:
    """Returns the weighted loss terms of a step by name."""
    # Split, not sliced: backward through slices would allocate and add whole images.
    channels, depths = rendering.image.shape[2] - 3, int(anchors is not None)
    rgb, codes, squared = torch.split(rendering.image, [3, channels - depths, depths], dim=2)
    if correction is not None:
        rgb = corrected_for(rgb, correction, target)
    terms = {"image": image_loss(rgb, target, settings.ssim_weight, frame.valid)}
    if class_weights is not None and frame.labels is not None:
        cross_entropy = label_loss(codes, parameters, frame.labels, frame.valid, class_weights)
        terms["semantic"] = settings.semantic_weight * settings.semantic_every * cross_entropy
    if anchors is not None:
        terms |= depth_terms(rendering, squared[..., 0], anchors, target, frame.valid, settings)
        if frame.depth is not None and settings.sensor_depth_weight:
            error = sensor_depth_error(rendering.alpha, rendering.depth, frame.depth, frame.valid)
            terms["sensor_depth"] = settings.sensor_depth_weight * settings.depth_every * error
    terms["opacity"] = _OPACITY_DECAY * splats.opacities.mean()
    terms["scale"] = _SCALE_DECAY / extent * splats.scales.mean()
    return terms


def sensor_depth_error(alpha: Tensor, depth: Tensor, measured: Tensor, valid: Tensor | None = None) -> Tensor:
    """Mean of |ln(expected depth / measured depth)| over measured pixels, or 0.

    The logarithm measures relative errors, as sensors make them; the absolute value limits the pull of wrong
    measurements at edges and on glass. `measured` is camera z [H, W], 0 where unknown; see `depth_regularization` for
    the others.
    """
    counts = (measured > 0) & (alpha.detach() > _ALPHA_MIN) & (depth.detach() > 0)
    if valid is not None:
        counts = counts & valid
    ratio = torch.where(counts, depth, 1.0) / torch.where(counts, alpha * measured, 1.0)
    return torch.where(counts, ratio.log().abs(), 0.0).sum() / counts.sum().clamp_min(1)
