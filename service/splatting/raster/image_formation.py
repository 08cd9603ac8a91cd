"""Types and image formation shared by all rasterizer backends.

Shapes: G Gaussians, C feature channels, H×W pixels. Tensors of one call share dtype and device. The image formation is
that of 3D Gaussian splatting (Kerbl et al. 2023) with EWA projection: perspective mean, 2D covariance J R Σ Rᵀ Jᵀ +
eps2d·I, alpha = min(alpha_max, opacity·exp(−½ dᵀ Σ₂⁻¹ d)) dropped below alpha_min, front-to-back compositing in order
of camera-space z (ties by row), stopped once transmittance falls below transmittance_min. As in gsplat, J is evaluated
at a direction clamped to 1.3 times the field of view; the mean itself is not clamped.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

Backend = Literal["reference", "cpu", "cuda"]


@dataclass(frozen=True)
class RasterSettings:
    """Cut-offs of every backend, forward and backward.

    Attributes:
        alpha_max: alpha is clamped to this, without gradient. `cuda` always clamps to 0.999, which changes nearly
            opaque Gaussians by up to 0.9 %.
        transmittance_min: compositing stops before the Gaussian that would reduce transmittance to or below this.
            `cuda` requires 1e-4.
        max_isects: limit of Gaussian-tile intersections per call; exceeding it raises `ResourceError`.
    """

    alpha_min: float = 1.0 / 255.0  # smaller alphas are dropped; `cuda` requires 1/255
    alpha_max: float = 0.99
    transmittance_min: float = 1e-4
    near: float = 0.01  # camera z up to this is culled, scene units
    far: float = 1e10  # camera z from this on is culled, scene units
    eps2d: float = 0.3  # added to the diagonal of the 2D covariance, pixels²
    max_isects: int = 50_000_000


@dataclass(frozen=True)
class Splats:
    """Activated Gaussians, world frame.

    >>> rgb = torch.tensor([[1.0, 0, 0]])
    >>> Splats(torch.zeros(1, 3), torch.eye(1, 4), torch.ones(1, 3), torch.ones(1), rgb).features.shape
    torch.Size([1, 3])
    """

    means: Tensor  # [G, 3], scene units
    quats: Tensor  # [G, 4], w x y z, normalized by the rasterizer; zero or non-finite ones are culled
    scales: Tensor  # [G, 3], standard deviations, scene units
    opacities: Tensor  # [G], 0..1
    features: Tensor  # [G, C], channels to composite (RGB, codes, ...)


@dataclass(frozen=True)
class Rendering:
    """A rendered view; gradients flow through `image`, `alpha` and `depth`.

    Attributes:
        median_depth: [H, W], camera z of the Gaussian where transmittance first falls to 0.5 or below, else 0; None
            from `cuda` with gradients on.
    """

    image: Tensor  # [H, W, C] = Σ w·feature + (1 − alpha)·background, w = alpha_i·T_i
    alpha: Tensor  # [H, W] = Σ w
    depth: Tensor  # [H, W] = Σ w·z with camera z; divide by alpha for the expected depth
    median_depth: Tensor | None
    radii: Tensor  # int32 [G], footprint radius in pixels, 0 if culled
    culled_non_finite: int  # Gaussians dropped for NaN or infinite inputs


@dataclass(frozen=True)
class LabelMap:
    """Labels of a view, without gradients."""

    classes: Tensor  # int32 [H, W], most probable class; 0 where alpha is below the limit
    alpha: Tensor  # [H, W] = Σ w
    relevancy: Tensor | None  # [H, W] = Σ_n p(n)·relevancy(n), p the softmax, for any alpha; None unless requested
    image: Tensor  # [H, W, C − D], the channels before the codes, composited on zero
    culled_non_finite: int  # Gaussians dropped for NaN or infinite inputs


@dataclass(frozen=True)
class LabelSums:
    """Blend weight of each Gaussian by label, M positive entries in CSR."""

    starts: Tensor  # int64 [G + 1]; row g is entries starts[g] to starts[g + 1]
    labels: Tensor  # int32 [M], ascending within a row
    sums: Tensor  # float64 [M], Σ_p w_g(p)·1[labels(p) = n] > 0, in pixels

    def dense(self, classes: int) -> Tensor:
        """Converts to a dense float64 [G, classes] matrix.

        >>> LabelSums(torch.tensor([0, 1, 1]), torch.tensor([2]), torch.tensor([0.5], dtype=torch.float64)).dense(3)
        tensor([[0.0000, 0.0000, 0.5000],
                [0.0000, 0.0000, 0.0000]], dtype=torch.float64)
        """
        count = len(self.starts) - 1
        rows = torch.arange(count, device=self.starts.device).repeat_interleave(self.starts.diff())
        out = torch.zeros(count, classes, dtype=torch.float64, device=self.sums.device)
        out[rows, self.labels.long()] = self.sums
        return out
