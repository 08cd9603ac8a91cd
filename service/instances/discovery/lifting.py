"""Lifting of a view's overlapping masks to Gaussians in one rasterization."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import csr_array
from torch import Tensor

from fastsplat.service.splatting.labels.region_groups import LiftedRegions, lift_regions, one_piece_each
from fastsplat.service.splatting.raster.image_formation import Backend, LabelSums, Splats
from fastsplat.service.splatting.raster.rendering import label_sums
from fastsplat_contract.geometry.camera import Camera


def image_pieces(masks: NDArray[np.bool_]) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Divides an image into pieces of pixels that lie in the same masks.

    Args:
        masks: bool [P, H, W].

    Returns:
        int32 [H, W], the piece of each pixel, 0..A − 1; and bool [A, P], True for the masks that contain a piece.
    """
    count, height, width = masks.shape
    if not count:
        return np.zeros((height, width), np.int32), np.zeros((1, 0), np.bool_)
    bits = np.ascontiguousarray(np.packbits(masks.reshape(count, -1), axis=0).T)
    keys = bits.view(np.dtype((np.void, bits.shape[1])))[:, 0]
    _, first, piece = np.unique(keys, return_index=True, return_inverse=True)
    return piece.reshape(height, width).astype(np.int32), np.ascontiguousarray(masks.reshape(count, -1)[:, first].T)


def lift_masks(
    splats: Splats,
    viewmat: Tensor,
    camera: Camera,
    masks: NDArray[np.bool_],
    *,
    valid: NDArray[np.bool_] | None = None,
    backend: Backend = "cpu",
) -> LiftedRegions:
    """Lifts each mask to the Gaussians with more than half of their weight in it.

    Args:
        splats: G activated Gaussians.
        viewmat: [4, 4], camera from world.
        camera: of the masks' size.
        masks: bool [P, H, W].
        valid: bool [H, W]; other pixels are ignored.
    """
    pieces, members = image_pieces(masks)
    sums = _sums(splats, viewmat, camera, pieces, len(members), valid, backend)
    return lift_regions(sums, csr_array(members.astype(np.float64)))


def lift_regions_of(
    splats: Splats, viewmat: Tensor, camera: Camera, ids: NDArray[np.integer], count: int, *, backend: Backend = "cpu"
) -> LiftedRegions:
    """Lifts disjoint regions 1..`count` of an id map, int [H, W], like `lift_masks`."""
    sums = _sums(splats, viewmat, camera, ids.astype(np.int32), count + 1, None, backend)
    return lift_regions(sums, one_piece_each(count, sums))


def _sums(
    splats: Splats,
    viewmat: Tensor,
    camera: Camera,
    pieces: NDArray[np.int32],
    count: int,
    valid: NDArray[np.bool_] | None,
    backend: Backend,
) -> LabelSums:
    image = torch.from_numpy(pieces if valid is None else np.where(valid, pieces, np.int32(-1)))
    device = splats.means.device
    sums = label_sums(splats, viewmat.to(device), camera, image.to(device), count, backend=backend)
    return LabelSums(sums.starts.cpu(), sums.labels.cpu(), sums.sums.cpu())
