"""Masks in the encodings that a request may ask for."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.calls.types import Mask3dEncoding, MaskEncoding, RleMask, ViewMask
from fastsplat.service.common.camera import PosedCamera
from fastsplat.service.common.errors import InvalidInputError
from fastsplat.service.query import Answer, SceneIndex
from fastsplat.service.query.pictures import png_bytes
from fastsplat.service.query.rle import encode_rle, pack_bits, unpack_bits
from fastsplat.service.scene import Gaussians, write_ply

_U32 = np.dtype("<u4")


def view_mask(
    index: SceneIndex, answer: Answer, view: str, camera_index: int, posed: PosedCamera, encoding: MaskEncoding
) -> ViewMask:
    """Where an answer is in one camera."""
    mask = index.mask2d(answer, posed).mask
    area = int(mask.sum())
    if encoding == "png":
        return ViewMask(view, camera_index, area, None, png_bytes(mask.astype(np.uint8) * 255))
    return ViewMask(view, camera_index, area, RleMask(mask.shape[0], mask.shape[1], encode_rle(mask)))


def encode_mask3d(mask: NDArray[np.bool_], encoding: Mask3dEncoding, gaussians: Gaussians) -> bytes:
    """A bool [G] mask as `QueryAnswer.mask3d` describes."""
    if encoding == "bits":
        return pack_bits(mask)
    if encoding == "indices":
        return np.flatnonzero(mask).astype(_U32).tobytes()
    if encoding == "runs":
        edges = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=2)) if len(mask) else np.zeros(0)
        return np.diff(edges, prepend=0).astype(_U32).tobytes()
    return mask_ply(gaussians, mask)


def decode_mask3d(data: bytes, encoding: Mask3dEncoding, count: int) -> NDArray[np.bool_]:
    """bool [count] of "bits", "runs" or "indices".

    Raises:
        InvalidInputError: the bytes do not describe `count` Gaussians, or are a PLY, which does not say the rows.
    """
    if encoding == "bits":
        return unpack_bits(data, count)
    if encoding == "ply" or len(data) % _U32.itemsize:
        raise InvalidInputError(f"{len(data)} bytes are no mask as {encoding}", field="mask3d")
    numbers = np.frombuffer(data, dtype=_U32).astype(np.int64)
    if encoding == "runs":
        if numbers.sum() != count:
            raise InvalidInputError(f"runs over {numbers.sum()} Gaussians, not {count}", field="mask3d")
        return np.repeat(np.arange(len(numbers)) % 2 == 1, numbers)
    if len(numbers) and (numbers.max() >= count or (np.diff(numbers) <= 0).any()):
        raise InvalidInputError(f"row numbers that do not ascend below {count}", field="mask3d")
    mask = np.zeros(count, dtype=np.bool_)
    mask[numbers] = True
    return mask


def mask_ply(gaussians: Gaussians, mask: NDArray[np.bool_]) -> bytes:
    """Just these Gaussians as a 3DGS PLY."""
    with tempfile.TemporaryDirectory(prefix="fastsplat-") as folder:
        path = Path(folder) / "mask.ply"
        write_ply(gaussians, path, rows=mask)
        return path.read_bytes()
