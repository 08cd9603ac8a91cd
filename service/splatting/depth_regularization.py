"""Terms of the loss for surfaces that can be measured by: what a pixel blends lies at one depth, points of the capture
lie on the surface, and what has no texture is plane.

Color alone leaves depth open: thin Gaussians explain a glossy table by what it mirrors. All terms need the rasterizer's
gradients by its alpha, its depth and one more feature only.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from fastsplat.service.splatting.raster.types import Rendering
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.splatting.training_views import Frame, TrainingView
from fastsplat_contract.errors import InvalidInputError

MAX_ANCHORS = 20_000
"""Points of a capture that are used; projecting them is then a small part of a step."""
_ALPHA_MIN = 0.1
"""Pixels less covered than this have no depth here."""
_SAME_SURFACE = 0.3
"""A depth that differs from a point's by a larger share of it is of something else, in front of the point or behind."""
_SAME_COLOR = 0.1
"""A pixel whose color differs from a point's by more in a channel, 0..1, does not show the point."""
_EDGE_SCALE = 20.0
_STEP_SHARE = 0.015


@dataclass(frozen=True)
class AnchorPoints:
    """Points of the capture that lie on surfaces, float32 [P, 3], world frame, and their colors [P, 3], 0..1."""

    points: Tensor
    colors: Tensor


@dataclass(frozen=True)
class DepthAnchors:
    """Points that a frame shows: their pixels, int64 [A], and camera z, float32 [A], scene units."""

    rows: Tensor
    columns: Tensor
    depths: Tensor


def squared_depths(means: Tensor, viewmat: Tensor) -> Tensor:
    """[G, 1]: camera z squared of every Gaussian, to be composited as a feature; differentiable in the means."""
    z = means @ viewmat[2, :3] + viewmat[2, 3]
    return (z * z)[:, None]


def depth_terms(
    rendering: Rendering,
    squared: Tensor,
    anchors: DepthAnchors,
    target: Tensor,
    valid: Tensor | None,
    settings: TrainingSettings,
) -> dict[str, Tensor]:
    """The weighted terms of this module, by name; those of weight 0 are left out. `depth_spread` and `depth_roughness`
    are one term, "depth_surface": one pass computes both with their gradients where all is float32 on the CPU.

    Args:
        rendering: alpha and depth of a frame.
        squared: [H, W], `squared_depths` composited.
        target: [H, W, 3], its image, 0..1.
        valid: bool [H, W], pixels of it that have content; None where all do.
        settings: weights, and `depth_every`, by which each is multiplied because it enters only so often.
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
    """The weighted sum of `depth_spread` and `depth_roughness`, see there; `InvalidInputError` without a pixel."""
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
    """Mean over pixels of Σ_ij w_i w_j ((z_i − z_j) / z̄)² / 2, z̄ the expected depth, without a gradient of it: the
    distortion loss of Mip-NeRF 360 (Barron et al. 2022) and 2DGS (Huang et al. 2024), in shares of the depth. The
    arguments are [H, W]: Σ w, Σ w z and Σ w z²."""
    covered = alpha.detach() > _ALPHA_MIN
    expected = torch.where(covered, depth / alpha.clamp_min(_ALPHA_MIN), 1.0).detach()
    spread = (alpha * squared - depth * depth).clamp_min(0.0) / (expected * expected)
    return torch.where(covered, spread, 0.0).mean()


def depth_roughness(alpha: Tensor, depth: Tensor, target: Tensor, valid: Tensor | None = None) -> Tensor:
    """How far inverse depth is from affine in pixels' coordinates, as it is on planes: the mean over pixels and both
    axes of e^(−20 |difference of colors|) |q(p − s) − 2 q(p) + q(p + s)| / q(p), s = 1.5 % of the longer side, each
    at most 1.

    Args:
        alpha, depth: [H, W], Σ w and Σ w z.
        target: [H, W, 3], the photo, 0..1; where its colors differ, a surface may end.
        valid: bool [H, W], pixels that count; None where all do.
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
        edge = torch.where(known, edge, 0.0)  # before the exponential: the gradient of one left out is 0 × NaN
        bend = (before - 2 * here + after).abs() / torch.where(known, here.detach(), 1.0)
        total = total + torch.where(known, torch.exp(-_EDGE_SCALE * edge) * bend.clamp(max=1.0), 0.0).mean()
    return total / 2


def _bend_step(image: Tensor) -> int:
    """Pixels between the three points of a bend."""
    return max(1, round(_STEP_SHARE * max(image.shape)))


def anchor_error(alpha: Tensor, depth: Tensor, anchors: DepthAnchors) -> Tensor:
    """Mean over the anchors of |expected depth / anchor's depth − 1|, where it is below 0.3 (beyond, the pixel shows
    something else, which counts 0), with alpha Σ w and depth Σ w z, [H, W]; 0 without anchors."""
    if not len(anchors.depths):
        return depth.new_zeros(())
    covered = alpha[anchors.rows, anchors.columns]
    expected = depth[anchors.rows, anchors.columns] / covered.clamp_min(_ALPHA_MIN)
    error = (expected / anchors.depths - 1).abs()
    counts = (covered.detach() > _ALPHA_MIN) & (error.detach() < _SAME_SURFACE)
    return torch.where(counts, error, 0.0).mean()


def depth_anchors(anchor_points: AnchorPoints, view: TrainingView, frame: Frame) -> DepthAnchors:
    """The points that the frame shows: in front of the camera, on a valid pixel of their color (what hides a point
    rarely has it)."""
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
