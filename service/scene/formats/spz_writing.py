"""Writes Gaussians as Niantic's SPZ: fixed-point columns, compressed.

Version 3 is one gzip stream, version 4 a zstd stream per column; files are less than a quarter of the PLY. The layout
is that of the reference library. Its axes are right, up, back, those of 3DGS files right, down, front, so y and z
change sign. Read by `service.capture.uploads.splat_files.spz`.
"""

from __future__ import annotations

import gzip
import struct
from typing import Literal

import numpy as np
import zstandard
from numpy.typing import NDArray

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.scene.artefact.scene import F32, Gaussians

MOST_FRACTIONAL_BITS = 16
"""Fractional bits of a 24-bit coordinate for scenes within ±128 units."""

_LEAST_FRACTIONAL_BITS = 8
_LARGEST = (1 << 23) - 1
_HEADER = struct.Struct("<4sIIBBBB")
_HEADER_REST = struct.Struct("<I12x")
_LEVEL = 6
_ZSTD_LEVEL = 12
_COLOR_SCALE = 0.15
_POWERS_OF_YZ = (1, 1, 0, 1, 2, 2, 1, 2, 3, 2, 3, 3, 2, 3, 2)  # of y, z, x; xy, yz, z², xz, x² − y²; …

U8 = NDArray[np.uint8]


def spz_bytes(gaussians: Gaussians, version: Literal[3, 4] = 3) -> bytes:
    """Encodes up to 2³² − 1 Gaussians, deterministically and without codes.

    Maximum errors: positions 2^−(bits + 1) scene units with `fractional_bits`, opacities 1/510, log scales 1/32,
    constant coefficients 1/76, higher ones 1/256, the three smaller components of unit quaternions 1/1445. Values are
    clipped to log scales −10 to 5.9, constant coefficients ±3.3, higher ones ±1, positions ±2^(23 − bits).
    """
    count, bits = len(gaussians), fractional_bits(gaussians.means)
    parts = list[bytes]()
    for column in (
        lambda: _positions(gaussians.means, bits),
        lambda: _bytes(255 / (1 + np.exp(-gaussians.logit_opacities.astype(np.float64)))),
        lambda: _bytes((gaussians.sh[:, 0] * _COLOR_SCALE + 0.5) * 255),
        lambda: _bytes((gaussians.log_scales + 10) * 16),
        lambda: _smallest_three(gaussians.quats),
        lambda: _harmonics(gaussians.sh),
    ):
        check_cancelled()
        parts.append(column().tobytes())
    parts = [part for part in parts if part or version == 3]
    head = _HEADER.pack(b"NGSP", version, count, gaussians.sh_degree, bits, 0, len(parts) if version == 4 else 0)
    if version == 3:
        return gzip.compress(b"".join([head, *parts]), _LEVEL, mtime=0)
    streams = [zstandard.ZstdCompressor(_ZSTD_LEVEL).compress(part) for part in parts]
    table = [struct.pack("<QQ", len(stream), len(part)) for stream, part in zip(streams, parts, strict=True)]
    return b"".join([head, _HEADER_REST.pack(_HEADER.size + _HEADER_REST.size), *table, *streams])


def fractional_bits(means: F32) -> int:
    """Returns the fractional bits, 8 to 16, with which means [G, 3] fit 24 bits."""
    furthest = float(np.abs(means).max(initial=0.0))
    for bits in range(MOST_FRACTIONAL_BITS, _LEAST_FRACTIONAL_BITS, -1):
        if furthest * (1 << bits) <= _LARGEST:
            return bits
    return _LEAST_FRACTIONAL_BITS


def _positions(means: F32, bits: int) -> U8:
    """Encodes three 24-bit little-endian two's complement numbers, uint8 [G, 9]."""
    steps = np.rint(means.astype(np.float64) * np.array([1, -1, -1]) * (1 << bits))
    fixed = np.clip(steps, -_LARGEST, _LARGEST).astype("<i4")
    return np.ascontiguousarray(fixed.reshape(-1, 1).view(np.uint8)[:, :3])


def _harmonics(sh: F32) -> U8:
    signs = (-1.0) ** np.array(_POWERS_OF_YZ[: sh.shape[1] - 1], np.float32)
    return _bytes(sh[:, 1:] * signs[:, None] * 128 + 128)


def _smallest_three(quats: F32) -> NDArray[np.uint32]:
    """Encodes quaternions as the largest's index (two bits) and the others (sign, nine bits)."""
    flip = np.array([-1.0, -1.0, 1.0])  # y, z, w of a rotation seen after a half turn about x
    xyzw = np.concatenate([quats[:, 1:2], quats[:, 2:4] * flip[:2], quats[:, :1] * flip[2]], axis=1).astype(np.float64)
    xyzw /= np.maximum(np.linalg.norm(xyzw, axis=1, keepdims=True), 1e-30)
    largest = np.abs(xyzw).argmax(axis=1)
    xyzw *= np.where(np.take_along_axis(xyzw, largest[:, None], axis=1) < 0, -1.0, 1.0)
    words = largest.astype(np.uint32)
    for place in range(3):
        column = place + (largest <= place)
        value = np.take_along_axis(xyzw, column[:, None], axis=1)[:, 0]
        magnitude = np.clip(np.rint(np.abs(value) * (511 / np.sqrt(0.5))), 0, 511).astype(np.uint32)
        words = words << np.uint32(10) | (value < 0).astype(np.uint32) << np.uint32(9) | magnitude
    return np.asarray(words, "<u4")


def _bytes(values: NDArray[np.floating]) -> U8:
    return np.asarray(np.clip(np.rint(values), 0, 255), np.uint8)
