"""Encodings of answer masks."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.query.drawing.pictures import png_bytes
from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.scene.formats.ply import write_ply
from fastsplat_contract.masks import Mask3dEncoding, MaskEncoding, Segmentation, ViewMask, encode_rle, pack_mask3d


def encoded_mask(mask: NDArray[np.bool_], view: str, camera_index: int, encoding: MaskEncoding) -> ViewMask:
    """Encodes a bool [H, W] mask."""
    area = int(mask.sum())
    if encoding == "png":
        return ViewMask(view, camera_index, None, png_bytes(mask.astype(np.uint8) * 255), area)
    height, width = mask.shape
    return ViewMask(view, camera_index, Segmentation((height, width), encode_rle(mask)), None, area)


def encode_mask3d(mask: NDArray[np.bool_], encoding: Mask3dEncoding, gaussians: Gaussians) -> bytes:
    """Encodes a bool [G] mask, see `QueryRequest.mask3d_encoding`."""
    return mask_ply(gaussians, mask) if encoding == "ply" else pack_mask3d(mask, encoding)


def mask_ply(gaussians: Gaussians, mask: NDArray[np.bool_]) -> bytes:
    """3DGS PLY of the masked Gaussians."""
    with tempfile.TemporaryDirectory(prefix="fastsplat-") as folder:
        path = Path(folder) / "mask.ply"
        write_ply(gaussians, path, rows=mask)
        return path.read_bytes()
