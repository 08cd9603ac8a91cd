"""Surface geometry of a view: depth, its spread, normals and confidence."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from fastsplat.service.scene.artefact.scene import F32
from fastsplat.service.splatting.gaussians import rotate
from fastsplat.service.splatting.raster.image_formation import Backend, Splats
from fastsplat.service.splatting.raster.rendering import rasterize
from fastsplat_contract.geometry.camera import PosedCamera

RELATIVE_SPREAD = 0.05
"""Relative spread of the blended depth that halves the confidence."""


@dataclass(frozen=True)
class ViewGeometry:
    """Surface geometry of a view; 0 everywhere where alpha < `alpha_min`."""

    depth: F32  # float32 [H, W], expected camera z Σ w·z / Σ w, scene units
    median_depth: F32  # float32 [H, W], camera z of the Gaussian where half of the light is gone
    spread: F32  # float32 [H, W], standard deviation of the blended depth √(Σ w·(z − depth)² / Σ w), scene units
    normals: F32  # float32 [H, W, 3], unit length, world frame, towards the camera
    confidence: F32  # float32 [H, W], 0..1: alpha / (1 + (spread / (`RELATIVE_SPREAD`·depth))²)
    image: F32  # float32 [H, W, C], the features Σ w·feature / Σ w


@torch.no_grad()
def view_geometry(splats: Splats, posed: PosedCamera, *, alpha_min: float, backend: Backend) -> ViewGeometry:
    """Renders depth, spread and normals with the features of `splats` in one rasterization.

    A pixel's normal blends its Gaussians' shortest axes, each turned towards the camera: with true depth these are
    closer to the truth than slopes of the rendered depth (figures in docs/take_away.md)."""
    viewmat = torch.tensor(posed.camera_from_world(), dtype=splats.means.dtype, device=splats.means.device)
    center = torch.tensor(posed.world_from_camera[:3, 3], dtype=splats.means.dtype, device=splats.means.device)
    z = splats.means @ viewmat[2, :3] + viewmat[2, 3]
    in_front = z[z > 0]
    middle = in_front.median() if len(in_front) else z.new_zeros(())  # squares of differences keep their digits
    offsets = (z - middle)[:, None]
    units = torch.eye(3, dtype=splats.quats.dtype, device=splats.quats.device)
    axes = rotate(splats.quats, units[splats.scales.argmin(dim=1)])
    towards = axes * torch.sign(((center - splats.means) * axes).sum(dim=1, keepdim=True))
    features = torch.cat([splats.features, offsets, offsets**2, towards], dim=1)
    drawn = rasterize(replace(splats, features=features), viewmat, posed.camera, backend=backend)
    weight = drawn.alpha.clamp_min(1e-6)
    there = drawn.alpha >= max(alpha_min, 1e-6)
    channels = splats.features.shape[1]
    blended = drawn.image / weight[..., None]
    mean, square = blended[..., channels], blended[..., channels + 1]
    spread = (square - mean**2).clamp_min(0.0).sqrt()
    depth = drawn.depth / weight
    normals = torch.nn.functional.normalize(blended[..., channels + 2 :], dim=-1)
    assert drawn.median_depth is not None  # no gradient is taken
    confidence = drawn.alpha / (1 + (spread / (RELATIVE_SPREAD * depth.clamp_min(1e-6))) ** 2)

    def array(values: Tensor) -> F32:
        mask = there if values.dim() == 2 else there[..., None]
        return np.asarray(torch.where(mask, values, 0.0).to(torch.float32).cpu().numpy())

    return ViewGeometry(
        depth=array(depth),
        median_depth=array(drawn.median_depth),
        spread=array(spread),
        normals=array(normals),
        confidence=array(confidence),
        image=array(blended[..., :channels]),
    )
