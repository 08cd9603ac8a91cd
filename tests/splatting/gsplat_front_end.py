"""gsplat's own front end on the CPU, independent of the product, with its CUDA kernels replaced.

Projection and tile lists are its own PyTorch version, vectorized (a test compares); pixels are written after
`RasterizeToPixels3DGSFwd.cu`.
"""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from torch import Tensor

ALPHA_MIN = 1.0 / 255.0
ALPHA_MAX = 0.999
TRANSMITTANCE_MIN = 1e-4  # what the kernels fix; `test_gsplat_contract` reads them from the sources

needs_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="no NVIDIA GPU")
"""Of a test of gsplat's kernels themselves; gsplat is among the development tools."""


def install(monkeypatch: pytest.MonkeyPatch) -> Any:
    """gsplat with its kernels replaced until the test ends."""
    import gsplat
    from gsplat import rendering

    for name, function in {
        "fully_fused_projection": _project,
        "isect_tiles": isect_tiles,
        "isect_offset_encode": _offsets,
        "rasterize_to_pixels": _composite,
    }.items():
        monkeypatch.setattr(rendering, name, function)
    monkeypatch.setattr(gsplat, "spherical_harmonics", _spherical_harmonics)
    return gsplat


def _spherical_harmonics(degrees_to_use: int, dirs: Tensor, coeffs: Tensor) -> Tensor:
    from gsplat.cuda._torch_impl import _spherical_harmonics

    return _spherical_harmonics(degrees_to_use, dirs, coeffs)


def _project(
    means: Tensor, covars: None, quats: Tensor, scales: Tensor, viewmats: Tensor, ks: Tensor, width: int, height: int,
    *, eps2d: float, packed: bool, near_plane: float, far_plane: float, radius_clip: float, sparse_grad: bool,
    calc_compensations: bool, camera_model: str, opacities: Tensor,
) -> tuple[Tensor, ...]:  # fmt: skip
    from gsplat.cuda._torch_impl import _fully_fused_projection, _quat_scale_to_covar_preci

    assert covars is None and not packed and not sparse_grad and radius_clip == 0.0 and not calc_compensations
    covariances, _ = _quat_scale_to_covar_preci(quats, scales, True, False)
    return _fully_fused_projection(
        means, covariances, viewmats, ks, width, height, eps2d, near_plane, far_plane, False, camera_model
    )


@torch.no_grad()
def isect_tiles(
    means2d: Tensor, radii: Tensor, depths: Tensor, tile_size: int, tile_width: int, tile_height: int, **rest: Any
) -> tuple[Tensor, Tensor, Tensor]:
    """Lists the Gaussians of the tiles by depth: int32 [1, N] tiles a Gaussian, int64 [M] keys, int32 [M] ids."""
    assert not rest.get("packed") and len(means2d) == 1
    size = torch.tensor([tile_width, tile_height], device=means2d.device)
    low = (torch.floor(means2d[0] / tile_size - radii[0] / tile_size)).int().clamp(min=0).minimum(size)
    high = (torch.ceil(means2d[0] / tile_size + radii[0] / tile_size)).int().clamp(min=0).minimum(size)
    counts = (high - low).prod(dim=-1) * (radii[0] > 0).all(dim=-1)
    ids = torch.repeat_interleave(torch.arange(len(counts), device=counts.device), counts)
    place = torch.arange(len(ids), device=ids.device) - (counts.cumsum(0) - counts)[ids]
    wide = (high - low)[ids, 0]
    tiles = (low[ids, 1] + place // wide) * tile_width + low[ids, 0] + place % wide
    keys, order = torch.sort((tiles.long() << 32) | depths[0].contiguous().view(torch.int32).long()[ids], stable=True)
    return counts[None].int(), keys, ids[order].int()


def _offsets(isect_ids: Tensor, n_images: int, tile_width: int, tile_height: int) -> Tensor:
    from gsplat.cuda._torch_impl import _isect_offset_encode

    return _isect_offset_encode(isect_ids, n_images, tile_width, tile_height)


def _composite(
    means2d: Tensor, conics: Tensor, colors: Tensor, opacities: Tensor, width: int, height: int, tile_size: int,
    isect_offsets: Tensor, flatten_ids: Tensor, *, backgrounds: None, packed: bool, absgrad: bool,
) -> tuple[Tensor, Tensor]:  # fmt: skip
    """Composites tiles front to back as the kernel does, with its cut-offs `ALPHA_MIN` and `TRANSMITTANCE_MIN`."""
    assert backgrounds is None and not packed and not absgrad and len(means2d) == 1
    bounds = [*isect_offsets.flatten().tolist(), len(flatten_ids)]
    rows = []
    for top in range(math.ceil(height / tile_size)):
        row = []
        for left in range(math.ceil(width / tile_size)):
            at = top * math.ceil(width / tile_size) + left
            ids = flatten_ids[bounds[at] : bounds[at + 1]].long()
            y = torch.arange(top * tile_size, min((top + 1) * tile_size, height), device=means2d.device) + 0.5
            x = torch.arange(left * tile_size, min((left + 1) * tile_size, width), device=means2d.device) + 0.5
            dx = x[None, :, None] - means2d[0, ids, 0]
            dy = y[:, None, None] - means2d[0, ids, 1]
            a, b, c = conics[0, ids].unbind(-1)
            sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
            alpha = (opacities[0, ids] * torch.exp(-sigma)).clamp(max=ALPHA_MAX)
            alpha = torch.where((sigma < 0) | (alpha < ALPHA_MIN), 0.0, alpha)
            after = torch.cumprod(1.0 - alpha, dim=-1)
            before = torch.cat((torch.ones_like(after[..., :1]), after[..., :-1]), dim=-1)
            weights = torch.where(after > TRANSMITTANCE_MIN, alpha * before, 0.0)
            row.append(torch.cat((weights @ colors[0, ids], weights.sum(dim=-1, keepdim=True)), dim=-1))
        rows.append(torch.cat(row, dim=1))
    drawn = torch.cat(rows, dim=0)[None]
    return drawn[..., :-1], drawn[..., -1:]
