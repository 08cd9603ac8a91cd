"""Reads Niantic's SPZ, versions 2 to 4: fixed-point columns in gzip or zstd streams.

Axes are right, up, back unless an extension differs, and become those of 3DGS PLY.
"""

from __future__ import annotations

import gzip
import os
import struct
import zlib
from pathlib import Path
from typing import BinaryIO

import numpy as np
import zstandard
from numpy.typing import NDArray

from fastsplat.service.capture.uploads.splat_files.rows import (
    F32,
    SH_COUNTS,
    SplatLimits,
    SplatRows,
    bad_splat,
    check_count,
    logits,
    smallest_three,
)

_MAX_DEGREE = len(SH_COUNTS) - 1
_HEADER = struct.Struct("<4sIIBBBB")
MAGIC = b"NGSP"
_HEADER_REST = struct.Struct("<I12x")
_STREAM = struct.Struct("<QQ")
_RECORD = struct.Struct("<II")
_EXTENSIONS = 2
_COORDINATE_SYSTEM = 0xADBE0003
_RIGHT_UP_BACK, _MOST_SYSTEMS = 4, 8
_MAX_EXTENSION_BYTES = 1 << 20
_MAX_WINDOW_BYTES = 1 << 27
_MAX_FRACTIONAL_BITS = 23
_COLOR_SCALE = 0.15

U8 = NDArray[np.uint8]


def read_spz(path: Path, name: str, limits: SplatLimits) -> SplatRows:
    """Reads an SPZ file with 3DGS PLY axes; logits ±inf for bytes 0 and 255.

    Extensions other than the coordinate system are skipped. Raises as `read_splat_file`, and for swapped axes.
    """
    with path.open("rb") as file:
        packed = file.read(2) == b"\x1f\x8b"
        file.seek(0)
        pull = gzip.GzipFile(fileobj=file).read if packed else file.read
        try:
            count, degree, bits, version, flags = _read_header(name, pull(_HEADER.size), limits)
            if packed and version == 4:
                raise bad_splat(name, "is SPZ of version 4 with gzip around it")
            widths = {"means": 9, "alphas": 1, "colors": 3, "scales": 3, "quats": 3 if version == 2 else 4}
            sizes = {column: count * width for column, width in widths.items()}
            sizes["sh"] = count * 3 * (SH_COUNTS[degree] - 1)
            if version == 4:
                contents, records = _streams(file, name, [size for size in sizes.values() if size])
            else:
                contents = [pull(size) for size in sizes.values() if size]
                records = pull(_MAX_EXTENSION_BYTES) if flags & _EXTENSIONS else b""
            columns = {}
            for column, size in sizes.items():
                content = contents.pop(0) if size else b""
                if len(content) != size:
                    raise bad_splat(name, f"ends within its {column} of {count} Gaussians")
                columns[column] = np.frombuffer(content, np.uint8).reshape(count, -1)
            if version != 4 and pull(1):
                raise bad_splat(name, f"goes on behind its {count} Gaussians")
        except (zlib.error, EOFError, gzip.BadGzipFile, zstandard.ZstdError) as error:
            raise bad_splat(name, f"is not a whole stream: {str(error)[:80]}") from error
    x, y, z = _signs(records if flags & _EXTENSIONS else b"", name)
    colors = (columns["colors"].astype(np.float32) / 255 - 0.5) / _COLOR_SCALE
    higher = (columns["sh"].astype(np.float32) - 128).reshape(count, -1, 3) / 128
    turned = np.array([y, z, x, x * y, y * z, 1, x * z, 1, y, x * y * z, y, z, x, z, x], np.float32)  # m = −l..l
    quats = _first_three(columns["quats"]) if version == 2 else _quaternions(columns["quats"])
    return SplatRows(
        means=_fixed_point(columns["means"], bits) * np.array([x, y, z], np.float32) + 0,  # no −0
        quats=quats * np.array([1, y * z, x * z, x * y], np.float32) + 0,
        log_scales=np.asarray(columns["scales"].astype(np.float32) / 16 - 10, np.float32),
        logit_opacities=logits(columns["alphas"][:, 0]),
        sh=np.concatenate([colors[:, None], higher * turned[: higher.shape[1], None]], axis=1),
    )


def _streams(file: BinaryIO, name: str, sizes: list[int]) -> tuple[list[bytes], bytes]:
    """Reads the columns of version 4, one stream each, and the extension records before them."""
    head = file.read(_HEADER_REST.size)
    begin = _HEADER_REST.unpack(head)[0] if len(head) == _HEADER_REST.size else 0
    if not 0 <= begin - file.tell() <= _MAX_EXTENSION_BYTES:
        raise bad_splat(name, "has no table of its streams where its header says")
    records = file.read(begin - file.tell())
    table = file.read(_STREAM.size * len(sizes))
    lengths = list(_STREAM.iter_unpack(table)) if len(table) == _STREAM.size * len(sizes) else []
    if [whole for _, whole in lengths] != sizes or file.tell() + sum(length for length, _ in lengths) > os.fstat(
        file.fileno()
    ).st_size:
        raise bad_splat(name, "has streams of other sizes than its header says")
    contents = []
    for (length, _), size in zip(lengths, sizes, strict=True):
        inflater = zstandard.ZstdDecompressor(max_window_size=_MAX_WINDOW_BYTES)
        with inflater.stream_reader(file.read(length)) as stream:
            contents.append(stream.read(size))
    return contents, records


def _signs(records: bytes, name: str) -> tuple[int, int, int]:
    """Signs that turn x, y, z to right, down, front, as in PLY."""
    system = _RIGHT_UP_BACK
    while len(records) > _RECORD.size:
        kind, size = _RECORD.unpack_from(records)
        payload, records = records[_RECORD.size : _RECORD.size + size], records[_RECORD.size + size :]
        if kind == _COORDINATE_SYSTEM:
            system = int.from_bytes(payload, "little") or _RIGHT_UP_BACK
    if system > _MOST_SYSTEMS:
        raise bad_splat(name, f"has the coordinate system {system}, whose axes are swapped")
    right, up, front = (system - 1) & 1, (system - 1) & 2, (system - 1) & 4
    return 1 if right else -1, -1 if up else 1, 1 if front else -1


def _read_header(name: str, head: bytes, limits: SplatLimits) -> tuple[int, int, int, int, int]:
    """Reads count, degree, fractional bits, version and flags."""
    if len(head) < _HEADER.size or head[:4] != MAGIC:
        raise bad_splat(name, "has no SPZ header")
    _, version, count, degree, bits, flags, _ = _HEADER.unpack(head)
    if version not in (2, 3, 4):
        raise bad_splat(name, f"is SPZ of version {version}")
    if degree > _MAX_DEGREE:
        raise bad_splat(name, f"has harmonics of degree {degree}, at most {_MAX_DEGREE} is read")
    if bits > _MAX_FRACTIONAL_BITS:
        raise bad_splat(name, f"has positions with {bits} fractional bits of 24")
    check_count(name, count, limits)
    return count, degree, bits, version, flags


def _fixed_point(packed: U8, bits: int) -> F32:
    """Converts 24-bit two's complement, least significant byte first, to float32 [K, 3]."""
    parts = packed.reshape(-1, 3, 3).astype(np.int32)
    whole = parts[..., 0] | parts[..., 1] << 8 | parts[..., 2] << 16
    whole -= (whole & 0x800000) << 1
    return np.asarray(whole.astype(np.float32) / np.float32(1 << bits))


def _first_three(packed: U8) -> F32:
    """Unpacks quaternions w x y z of version 2, [K, 4]: bytes, w ≥ 0."""
    xyz = packed.astype(np.float32) / np.float32(127.5) - 1
    w = np.sqrt(np.maximum(0, 1 - (xyz**2).sum(axis=1, keepdims=True)))
    return np.concatenate([w, xyz], axis=1)


def _quaternions(packed: U8) -> F32:
    """Unpacks quaternions w x y z of version 3, [K, 4].

    Two bits index the largest of x y z w, the others have a sign and nine bits each, the last in the lowest.
    """
    word = np.ascontiguousarray(packed).view("<u4")
    parts = word >> np.array([20, 10, 0], np.uint32)
    magnitudes = (parts & 511).astype(np.float32) * np.float32(np.sqrt(0.5) / 511)
    xyzw = smallest_three((word[:, 0] >> 30).astype(np.intp), np.where(parts & 512, -magnitudes, magnitudes))
    return np.ascontiguousarray(xyzw[:, [3, 0, 1, 2]])
