"""The rasterizer's one interface; `reference`, `cpu` and `cuda` are its backends.

Shapes: G Gaussians, C feature channels, H×W pixels. Tensors of one call share dtype and device. The image formation
is that of 3D Gaussian splatting (Kerbl et al. 2023) with EWA projection: perspective mean, 2D covariance
J R Σ Rᵀ Jᵀ + eps2d·I, alpha = min(alpha_max, opacity·exp(−½ dᵀ Σ₂⁻¹ d)) dropped below alpha_min, front-to-back
compositing in order of camera-space z (ties by row), stopped once transmittance falls below transmittance_min. As in
gsplat, J is evaluated at a direction clamped to 1.3 times the field of view; the mean itself is not clamped.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

Backend = Literal["reference", "cpu", "cuda"]


@dataclass(frozen=True)
class RasterSettings:
    """Cut-offs, the same for every backend, forward and backward.

    Attributes:
        alpha_min: contributions below this are dropped. `cuda` has 1/255 and refuses other values.
        alpha_max: alpha is clamped to this; no gradient flows through a clamped alpha. `cuda` ignores it and clamps to
            0.999, which changes nearly opaque Gaussians by up to 0.9 %.
        transmittance_min: a pixel is finished before the Gaussian that would take its transmittance to or below this.
            `cuda` has 1e-4 and refuses other values.
        near: Gaussians with camera z at or below this are culled, scene units.
        far: Gaussians with camera z at or above this are culled, scene units.
        eps2d: added to the diagonal of the 2D covariance, pixels².
        max_isects: bound on Gaussian-tile intersections of a call; crossing it raises `ResourceError` naming it.
    """

    alpha_min: float = 1.0 / 255.0
    alpha_max: float = 0.99
    transmittance_min: float = 1e-4
    near: float = 0.01
    far: float = 1e10
    eps2d: float = 0.3
    max_isects: int = 50_000_000


@dataclass(frozen=True)
class Splats:
    """Activated Gaussians, world frame.

    Attributes:
        means: [G, 3], scene units.
        quats: [G, 4], w x y z, normalized by the rasterizer; a quaternion of length zero or non-finite is culled.
        scales: [G, 3], standard deviations, scene units.
        opacities: [G], 0..1.
        features: [G, C], whatever is to be composited (RGB, codes, ...).
    """

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    features: Tensor


@dataclass(frozen=True)
class Rendering:
    """One view. Gradients flow through `image`, `alpha` and `depth`.

    Attributes:
        image: [H, W, C] = Σ w·feature + (1 − alpha)·background, w = alpha_i·T_i.
        alpha: [H, W] = Σ w.
        depth: [H, W] = Σ w·z, the accumulated (not normalized) camera z; divide by alpha for the expected depth.
        median_depth: [H, W], camera z of the Gaussian where transmittance first falls to 0.5 or below, else 0; None
            from `cuda` where gradients are taken.
        radii: int32 [G], radius in pixels of each Gaussian's visible footprint, 0 for culled ones.
        culled_non_finite: how many Gaussians were dropped because one of their inputs was NaN or infinite.
    """

    image: Tensor
    alpha: Tensor
    depth: Tensor
    median_depth: Tensor | None
    radii: Tensor
    culled_non_finite: int


@dataclass(frozen=True)
class LabelMap:
    """What each pixel of a view shows. No gradients.

    Attributes:
        classes: int32 [H, W], argmax of the affine map of the composited code; 0 where alpha is below the bound.
        alpha: [H, W] = Σ w.
        relevancy: [H, W] = Σ_n p(n)·relevancy(n), p the softmax of the logits, whatever alpha is; None if not asked.
        image: [H, W, C − D], the channels before the codes, composited on zero.
        culled_non_finite: how many Gaussians were dropped because one of their inputs was NaN or infinite.
    """

    classes: Tensor
    alpha: Tensor
    relevancy: Tensor | None
    image: Tensor
    culled_non_finite: int


@dataclass(frozen=True)
class LabelSums:
    """Blend weight of each Gaussian by label, M positive entries in compressed rows (CSR).

    Attributes:
        starts: int64 [G + 1]; row g is entries starts[g] to starts[g + 1].
        labels: int32 [M], ascending within a row.
        sums: float64 [M], Σ_p w_g(p)·1[labels(p) = n] > 0, in pixels.
    """

    starts: Tensor
    labels: Tensor
    sums: Tensor

    def dense(self, classes: int) -> Tensor:
        """float64 [G, classes]; for few classes."""
        rows = torch.repeat_interleave(
            torch.arange(len(self.starts) - 1, device=self.starts.device), self.starts.diff()
        )
        out = torch.zeros(len(self.starts) - 1, classes, dtype=torch.float64, device=self.sums.device)
        out[rows, self.labels.long()] = self.sums
        return out
