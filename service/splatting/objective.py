"""What a step minimizes: a view rendered from a run's parameters, and the terms of its loss."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import torch
from torch import Tensor

from fastsplat.service.splatting.depth_regularization import DepthAnchors, depth_terms, squared_depths
from fastsplat.service.splatting.losses.functional import image_loss
from fastsplat.service.splatting.photometric import corrected_for
from fastsplat.service.splatting.raster.rendering import rasterize, sh_to_rgb
from fastsplat.service.splatting.raster.types import Backend, Rendering, Splats
from fastsplat.service.splatting.semantics import label_loss
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.splatting.training_views import Frame, TrainingView

_ALPHA_MIN = 0.1
"""Pixels less covered than this have no depth here."""
_OPACITY_DECAY = 0.02
"""Weight of the mean opacity in the loss (3DGS-MCMC), so that useless Gaussians die."""
_SCALE_DECAY = 0.01
"""Weight of the mean scale, in shares of the scene's extent, in the loss."""


def render_frame(
    parameters: Mapping[str, Tensor],
    splats: Splats,
    view: TrainingView,
    frame: Frame,
    *,
    degree: int,
    with_codes: bool = False,
    with_squared_depth: bool = False,
    background: Tensor | None = None,
    backend: Backend,
) -> Rendering:
    """The view at the size of `frame`: colors in the first 3 channels, composited codes behind them on request.

    Args:
        parameters: see `SplatState`; colors and codes are read.
        splats: their activation (`splats_of`); features are not read.
        view, frame: one of the view's frames.
        with_codes: whether codes are composited too, [H, W, 3 + D].
        with_squared_depth: whether camera z squared is composited too, as the last channel.
        background: RGB [3] behind the colors; black by default. The others have zero behind them.
    """
    sh = parameters["sh_dc"]
    if degree:
        sh = torch.cat([sh, parameters["sh_rest"][:, : (degree + 1) ** 2 - 1]], dim=1)
    features = sh_to_rgb(parameters["means"], sh, view.position, degree, backend=backend)
    if with_codes:
        features = torch.cat([features, parameters["codes"]], dim=1)
    if with_squared_depth:
        features = torch.cat([features, squared_depths(parameters["means"], view.viewmat)], dim=1)
    if background is not None:
        background = torch.cat([background, background.new_zeros(features.shape[1] - 3)])
    splats = replace(splats, features=features)
    return rasterize(splats, view.viewmat, frame.camera, background=background, backend=backend)


def loss_terms(
    rendering: Rendering,
    splats: Splats,
    parameters: Mapping[str, Tensor],
    frame: Frame,
    target: Tensor,
    class_weights: Tensor | None,
    extent: float,
    settings: TrainingSettings,
    anchors: DepthAnchors | None = None,
    correction: Tensor | None = None,
) -> dict[str, Tensor]:
    """The weighted terms whose sum is the loss of a step, by name.

    Args:
        rendering: of `render_frame`, with codes unless `class_weights` is None.
        splats, parameters: what was rendered.
        target: float32 [H, W, 3], the frame's image.
        class_weights: [N + 1], or None for no cross-entropy.
        extent: of the scene, scene units.
        anchors: of the frame, where the depth has terms too; `rendering` then has squared depths as its last channel.
        correction: [3] of the photo (`photometric`), or None for none.
    """
    # Split, not sliced: the backward pass of two slices would fill and add two whole images.
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
        terms |= sensor_depth_terms(rendering, frame, settings)
    terms["opacity"] = _OPACITY_DECAY * splats.opacities.mean()
    terms["scale"] = _SCALE_DECAY / extent * splats.scales.mean()
    return terms


def sensor_depth_terms(rendering: Rendering, frame: Frame, settings: TrainingSettings) -> dict[str, Tensor]:
    """The term of what a sensor measured, by name, times its weight and `depth_every`, as it enters only so often; none
    for a frame without measurements or a weight of 0."""
    if frame.depth is None or not settings.sensor_depth_weight:
        return {}
    error = sensor_depth_error(rendering.alpha, rendering.depth, frame.depth, frame.valid)
    return {"sensor_depth": settings.sensor_depth_weight * settings.depth_every * error}


def sensor_depth_error(alpha: Tensor, depth: Tensor, measured: Tensor, valid: Tensor | None = None) -> Tensor:
    """Mean over the measured pixels of |ln(expected depth / measured depth)|; 0 where there is none.

    The logarithm counts errors in shares of the depth, as sensors make them, and the absolute value lets a few wrong
    measurements, at edges and on glass, pull no harder than right ones.

    Args:
        alpha, depth: [H, W], Σ w and Σ w z.
        measured: [H, W] camera z, scene units; 0 where unknown.
        valid: bool [H, W], pixels that count; None where all do.
    """
    counts = (measured > 0) & (alpha.detach() > _ALPHA_MIN) & (depth.detach() > 0)
    if valid is not None:
        counts = counts & valid
    ratio = torch.where(counts, depth, 1.0) / torch.where(counts, alpha * measured, 1.0)
    return torch.where(counts, ratio.log().abs(), 0.0).sum() / counts.sum().clamp_min(1)
