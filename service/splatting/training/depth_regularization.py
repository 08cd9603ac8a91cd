"""Geometry losses: one depth per pixel, anchoring to capture points, planar textureless areas.

Color alone leaves depth ambiguous: thin Gaussians explain a glossy table by its reflections. The losses only need the
rasterizer's gradients of alpha, depth and one more feature. Parameters are composited images [H, W]: alpha = Σ w, depth
= Σ w z, squared = Σ w z²; target is the photo [H, W, 3], 0..1; valid is bool [H, W], None means all.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from fastsplat.service.splatting.raster.image_formation import Rendering
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat.service.splatting.training_views import Frame, TrainingView
from fastsplat_contract.errors import InvalidInputError

MAX_ANCHORS = 20_000
"""Maximum points used, so that projecting them is a small part of a step."""
_ALPHA_MIN = 0.1  # pixels with less alpha have no depth
_SAME_SURFACE = 0.3
"""Relative depth difference beyond which a point is not on the pixel's surface."""
_SAME_COLOR = 0.1
"""Channel difference, 0..1, beyond which a pixel does not show a point."""
_EDGE_SCALE = 20.0
_STEP_SHARE = 0.015


@dataclass(frozen=True)
class AnchorPoints:
    """Capture points that lie on surfaces."""

    points: Tensor  # [P, 3], world frame
    colors: Tensor  # [P, 3], 0..1


@dataclass(frozen=True)
class DepthAnchors:
    """Points visible in a frame."""

    rows: Tensor  # int64 [A]
    columns: Tensor  # int64 [A]
    depths: Tensor  # [A], camera z, scene units


def depth_terms(
    rendering: Rendering,
    squared: Tensor,
    anchors: DepthAnchors,
    target: Tensor,
    valid: Tensor | None,
    settings: TrainingSettings,
) -> dict[str, Tensor]:
    """Computes the weighted depth losses of nonzero weight, by name.

    "depth_surface" combines `depth_spread` and `depth_roughness`, fused in one pass for float32 on the CPU. Weights are
    multiplied by `depth_every`, the interval at which these losses are applied.
    """
    alpha, depth, every = rendering.alpha, rendering.depth, settings.depth_every
    terms = {}
    weights = every * settings.depth_spread_weight, every * settings.depth_smoothness_weight
    if any(weights):
        terms["depth_surface"] = surface_loss(alpha, depth, squared, target, valid, *weights)
    if settings.depth_anchor_weight:
        terms["depth_anchors"] = settings.depth_anchor_weight * every * anchor_error(alpha, depth, anchors)
    return terms


def surface_loss(
    alpha: Tensor,
    depth: Tensor,
    squared: Tensor,
    target: Tensor,
    valid: Tensor | None,
    spread_weight: float,
    smoothness_weight: float,
) -> Tensor:
    """Weighted sum of `depth_spread` and `depth_roughness`; rejects empty images."""
    if not alpha.numel():
        raise InvalidInputError(f"alpha {tuple(alpha.shape)} has no pixel", field="alpha")
    parts = (alpha, depth, squared, target)
    if any(part.dtype != torch.float32 or part.device.type != "cpu" for part in parts):
        spread, roughness = depth_spread(alpha, depth, squared), depth_roughness(alpha, depth, target, valid)
        return spread_weight * spread + smoothness_weight * roughness
    from fastsplat.service.splatting.losses import fused

    alpha, depth, target = alpha.contiguous(), depth.contiguous(), target.contiguous()
    valid = None if valid is None else valid.to(torch.bool).contiguous()
    loss: Tensor = fused.SurfaceLoss.apply(  # type: ignore[no-untyped-call]
        alpha, depth, squared, target, valid, _ALPHA_MIN, _bend_step(alpha), spread_weight, smoothness_weight
    )
    return loss


def depth_spread(alpha: Tensor, depth: Tensor, squared: Tensor) -> Tensor:
    """Mean over pixels of Σ_ij w_i w_j ((z_i − z_j) / z̄)² / 2.

    Distortion loss of Mip-NeRF 360 (Barron et al. 2022) and 2DGS (Huang et al. 2024), relative to the expected depth
    z̄, which gets no gradient.
    """
    covered = alpha.detach() > _ALPHA_MIN
    depth, squared = depth.where(covered, 0.0), squared.where(covered, 0.0)  # otherwise masked pixels give 0 × NaN
    expected = torch.where(covered, depth / alpha.clamp_min(_ALPHA_MIN), 1.0).detach()
    return ((alpha * squared - depth * depth).clamp_min(0.0) / (expected * expected)).where(covered, 0.0).mean()


def depth_roughness(alpha: Tensor, depth: Tensor, target: Tensor, valid: Tensor | None = None) -> Tensor:
    """Penalizes inverse depth that is not affine in pixel coordinates, as on planes.

    Mean over pixels and both axes of e^(−20 |color difference|) |q(p − s) − 2 q(p) + q(p + s)| / q(p), at most 1 each,
    s = 1.5 % of the longer side. Color edges may end a surface.
    """
    covered = (alpha.detach() > _ALPHA_MIN) & (depth.detach() > 0)
    if valid is not None:
        covered = covered & valid
    inverse = torch.where(covered, alpha / torch.where(covered, depth, 1.0), 0.0)
    step = _bend_step(alpha)
    total = depth.new_zeros(())
    for axis in (0, 1):
        size = alpha.shape[axis] - 2 * step
        if size <= 0:
            continue
        before, here, after = (torch.narrow(inverse, axis, start, size) for start in (0, step, 2 * step))
        colors = [torch.narrow(target, axis, start, size) for start in (0, step, 2 * step)]
        known = torch.narrow(covered, axis, 0, size)
        for start in (step, 2 * step):
            known = known & torch.narrow(covered, axis, start, size)
        edge = torch.maximum((colors[1] - colors[0]).abs(), (colors[2] - colors[1]).abs()).amax(dim=2)
        edge = torch.where(known, edge, 0.0)  # before the exponential: otherwise masked pixels give 0 × NaN
        bend = (before - 2 * here + after).abs() / torch.where(known, here.detach(), 1.0)
        total = total + torch.where(known, torch.exp(-_EDGE_SCALE * edge) * bend.clamp(max=1.0), 0.0).mean()
    return total / 2


def _bend_step(image: Tensor) -> int:
    """Distance in pixels between the three points of a bend."""
    return max(1, round(_STEP_SHARE * max(image.shape)))


def anchor_error(alpha: Tensor, depth: Tensor, anchors: DepthAnchors) -> Tensor:
    """Mean over anchors of |expected depth / anchor depth − 1|; 0 without anchors.

    Errors from 0.3 up count 0: the pixel shows another surface.
    """
    if not len(anchors.depths):
        return depth.new_zeros(())
    covered = alpha[anchors.rows, anchors.columns]
    expected = depth[anchors.rows, anchors.columns] / covered.clamp_min(_ALPHA_MIN)
    error = (expected / anchors.depths - 1).abs()
    counts = (covered.detach() > _ALPHA_MIN) & (error.detach() < _SAME_SURFACE)
    return torch.where(counts, error, 0.0).mean()


def depth_anchors(anchor_points: AnchorPoints, view: TrainingView, frame: Frame) -> DepthAnchors:
    """Selects points that project into the frame onto a valid pixel of their color.

    The color test replaces an occlusion test: an occluder rarely has the same color.
    """
    camera = frame.camera
    local = anchor_points.points @ view.viewmat[:3, :3].T + view.viewmat[:3, 3]
    z = local[:, 2].clamp_min(1e-6)
    columns = torch.floor(local[:, 0] / z * camera.fx + camera.cx)
    rows = torch.floor(local[:, 1] / z * camera.fy + camera.cy)
    inside = (local[:, 2] > 1e-6) & (rows >= 0) & (rows < camera.height) & (columns >= 0) & (columns < camera.width)
    ids = torch.nonzero(inside)[:, 0]
    rows, columns = rows[ids].long(), columns[ids].long()
    shade = frame.rgb[rows, columns].to(torch.float32) / 255
    alike = (shade - anchor_points.colors[ids]).abs().amax(dim=1) < _SAME_COLOR
    if frame.valid is not None:
        alike &= frame.valid[rows, columns]
    return DepthAnchors(rows[alike], columns[alike], z[ids][alike])
