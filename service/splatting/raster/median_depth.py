"""Median depth from gsplat's projection and tiles; its kernels compute none."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

_AT_ONCE = 32
"""Gaussians of a tile processed together; most pixels reach the median within these."""
_MOST_VALUES = 2**24  # pixels times Gaussians at once: 64 MiB per temporary


@torch.no_grad()
def median_depth(meta: Mapping[str, Any], height: int, width: int, *, alpha_min: float, alpha_max: float) -> Tensor:
    """Returns camera z where transmittance first falls to 0.5 or below, else 0, [height, width].

    Composites front to back in the order of gsplat's tile lists, by its kernel's rules
    (`service.splatting.raster.image_formation`). A pixel where the kernel stops early has passed the median already.

    Args:
        meta: of `gsplat.rasterization` for one view with `packed=False`: means2d [1, G, 2] in pixels, conics [1, G, 3],
            opacities and depths [1, G], isect_offsets [1, tile rows, tile columns], flatten_ids [M], tile_size in
            pixels.
    """
    starts, ids, side = meta["isect_offsets"][0], meta["flatten_ids"].long(), int(meta["tile_size"])
    rows, columns = starts.shape
    starts = starts.flatten().long()
    counts = starts.diff(append=torch.full((1,), len(ids), device=starts.device))
    found = torch.zeros(len(starts), side * side, device=starts.device)
    for tiles in torch.nonzero(counts)[:, 0].split(max(1, _MOST_VALUES // (_AT_ONCE * side * side))):
        found[tiles] = _of_tiles(meta, ids, tiles, starts[tiles], counts[tiles], columns, alpha_min, alpha_max)
    image = found.reshape(rows, columns, side, side).transpose(1, 2).reshape(rows * side, columns * side)
    return image[:height, :width].contiguous()


def _of_tiles(
    meta: Mapping[str, Any],
    ids: Tensor,
    tiles: Tensor,
    starts: Tensor,
    counts: Tensor,
    columns: int,
    alpha_min: float,
    alpha_max: float,
) -> Tensor:
    """Median depths of these tiles, [T, side²]; 0 where transmittance stays above 0.5."""
    side, device = int(meta["tile_size"]), tiles.device
    means2d, conics, opacities, depths = meta["means2d"][0], meta["conics"][0], meta["opacities"][0], meta["depths"][0]
    pixels = torch.arange(side * side, device=device)
    x = (tiles % columns * side)[:, None] + pixels % side + 0.5
    y = (tiles // columns * side)[:, None] + pixels // side + 0.5
    found = torch.zeros(x.shape, device=device)
    left = torch.ones(x.shape, device=device)
    going = torch.arange(len(tiles), device=device)
    for first in range(0, int(counts.max()), _AT_ONCE):
        going = going[(counts[going] > first) & (left[going] > 0.5).any(dim=1)]
        if not len(going):
            break
        place = first + torch.arange(_AT_ONCE, device=device)
        within = place < counts[going, None]
        rows = ids[(starts[going, None] + place).clamp(max=len(ids) - 1)]
        dx, dy = (p[going, :, None] - means2d[rows, i][:, None] for i, p in enumerate((x, y)))
        a, b, c = (conics[rows, i][:, None] for i in range(3))
        sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
        alpha = (opacities[rows][:, None] * torch.exp(-sigma)).clamp(max=alpha_max)
        drawn = within[:, None] & (sigma >= 0) & (alpha >= alpha_min)
        after = left[going, :, None] * torch.cumprod(1.0 - torch.where(drawn, alpha, 0.0), dim=2)
        half = after <= 0.5
        where = half.int().argmax(dim=2)  # argmax returns the first of equals
        newly = half.any(dim=2) & (left[going] > 0.5)
        found[going] = torch.where(newly, depths[rows].gather(1, where), found[going])
        left[going] = after[:, :, -1]
    return found
