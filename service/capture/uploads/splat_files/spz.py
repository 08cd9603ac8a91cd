"""Niantic's SPZ, versions 2 and 3: a gzip stream of fixed-point columns with the axes right, up, back. As its reference
converters do, y and z change their signs to those of 3DGS PLY files."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.uploads.splat_files.limits import SplatLimits, bad_splat, check_count
from fastsplat.service.capture.uploads.splat_files.rows import F32, SH_COUNTS, SplatRows

_MAX_DEGREE = len(SH_COUNTS) - 1
_HEADER = struct.Struct("<4sIIBBBB")
MAGIC = b"NGSP"
_EXTENSIONS = 2
_MAX_FRACTIONAL_BITS = 23
_COLOR_SCALE = 0.15
_PIECE = 1 << 20
_SIGNS = {
    "means": (1, -1, -1),
    "quats": (1, 1, -1, -1),  # w x y z: a half turn about x
    "sh": (-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1),
}
"""What a half turn about x does to each number; harmonics from degree 1, m = −l..l."""

U8 = NDArray[np.uint8]


def read_spz(path: Path, name: str, limits: SplatLimits) -> SplatRows:
    """The Gaussians of an SPZ file, in its order, with the axes of 3DGS PLY files; logits ±inf for the bytes 0 and 255.

    Raises:
        InvalidInputError: not an SPZ file of version 2 or 3, with extensions, or not of the size that its header says.
        LimitExceededError: more Gaussians than the limit.
    """
    with path.open("rb") as file:
        inflater = zlib.decompressobj(16 + zlib.MAX_WBITS)

        def pull(size: int) -> bytes:
            """`size` bytes of the content, fewer only at its end."""
            content = bytearray()
            while len(content) < size and not inflater.eof:
                source = inflater.unconsumed_tail or file.read(_PIECE)
                if not source:
                    break
                content += inflater.decompress(source, size - len(content))
            return bytes(content)

        try:
            head = pull(_HEADER.size)
            count, degree, bits, version = _read_header(name, head, limits)
            widths = {"means": 9, "alphas": 1, "colors": 3, "scales": 3, "quats": 3 if version == 2 else 4}
            widths["sh"] = 3 * (SH_COUNTS[degree] - 1)
            columns = {}
            for column, width in widths.items():
                content = pull(count * width)
                if len(content) != count * width:
                    raise bad_splat(name, f"ends within its {column} of {count} Gaussians")
                columns[column] = np.frombuffer(content, np.uint8).reshape(count, width)
            if pull(1):
                raise bad_splat(name, f"goes on behind its {count} Gaussians")
        except zlib.error as error:
            raise bad_splat(name, f"is not a whole gzip stream: {str(error)[:80]}") from error
    colors = (columns["colors"].astype(np.float32) / 255 - 0.5) / _COLOR_SCALE
    alphas = columns["alphas"][:, 0].astype(np.float32) / 255
    with np.errstate(divide="ignore"):
        logits = np.log(alphas) - np.log1p(-alphas)
    higher = (columns["sh"].astype(np.float32) - 128).reshape(count, -1, 3) / 128
    signs = np.array(_SIGNS["sh"][: higher.shape[1]], np.float32)[:, None]
    quats = _first_three(columns["quats"]) if version == 2 else _smallest_three(columns["quats"])
    return SplatRows(
        means=_fixed_point(columns["means"], bits) * np.array(_SIGNS["means"], np.float32) + 0,  # no −0
        quats=quats * np.array(_SIGNS["quats"], np.float32) + 0,
        log_scales=np.asarray(columns["scales"].astype(np.float32) / 16 - 10, np.float32),
        logit_opacities=logits,
        sh=np.concatenate([colors[:, None], higher * signs], axis=1),
    )


def _read_header(name: str, head: bytes, limits: SplatLimits) -> tuple[int, int, int, int]:
    """Number of Gaussians, degree of the harmonics, fractional bits of positions, and version."""
    if len(head) < _HEADER.size or head[:4] != MAGIC:
        raise bad_splat(name, "has no SPZ header in its gzip stream")
    _, version, count, degree, bits, flags, _ = _HEADER.unpack(head)
    if version not in (2, 3):
        raise bad_splat(name, f"is SPZ of version {version}")
    if flags & _EXTENSIONS:
        raise bad_splat(name, "is SPZ with extensions, which are not read; save it without")
    if degree > _MAX_DEGREE:
        raise bad_splat(name, f"has harmonics of degree {degree}, at most {_MAX_DEGREE} is read")
    if bits > _MAX_FRACTIONAL_BITS:
        raise bad_splat(name, f"has positions with {bits} fractional bits of 24")
    check_count(name, count, limits)
    return count, degree, bits, version


def _fixed_point(packed: U8, bits: int) -> F32:
    """float32 [K, 3] of 24-bit two's complement numbers, least significant byte first."""
    parts = packed.reshape(-1, 3, 3).astype(np.int32)
    whole = parts[..., 0] | parts[..., 1] << 8 | parts[..., 2] << 16
    whole -= (whole & 0x800000) << 1
    return np.asarray(whole.astype(np.float32) / np.float32(1 << bits))


def _first_three(packed: U8) -> F32:
    """float32 [K, 4] w x y z of version 2: x, y, z a byte each, w ≥ 0 from the unit length."""
    xyz = packed.astype(np.float32) / np.float32(127.5) - 1
    w = np.sqrt(np.maximum(0, 1 - (xyz**2).sum(axis=1, keepdims=True)))
    return np.concatenate([w, xyz], axis=1)


def _smallest_three(packed: U8) -> F32:
    """float32 [K, 4] w x y z of version 3: the place of the largest component (of x y z w) in two bits, the others as a
    sign and nine bits each, the last in the lowest."""
    word = np.ascontiguousarray(packed).view("<u4")[:, 0]
    place = (word >> 30).astype(np.intp)
    xyzw = np.zeros((len(word), 4), np.float32)
    for index in range(4):
        rows = np.flatnonzero(place == index)
        for shift, column in enumerate(own for own in (3, 2, 1, 0) if own != index):
            part = word[rows] >> np.uint32(10 * shift)
            magnitude = (part & 511).astype(np.float32) * np.float32(np.sqrt(0.5) / 511)
            xyzw[rows, column] = np.where(part & 512, -magnitude, magnitude)
        xyzw[rows, index] = np.sqrt(np.maximum(0, 1 - (xyzw[rows] ** 2).sum(axis=1)))
    return np.ascontiguousarray(xyzw[:, [3, 0, 1, 2]])
