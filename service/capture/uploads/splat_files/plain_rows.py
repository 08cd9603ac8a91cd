"""Reads antimatter15's `.splat` and mkkellogg's `.ksplat`, both with activated scales and opacities."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.uploads.splat_files.rows import (
    F32,
    SH_COUNTS,
    Y00,
    SplatLimits,
    SplatRows,
    bad_splat,
    check_count,
    logits,
)

_SPLAT = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("rgba", "u1", 4), ("quats", "u1", 4)])
_HEADER = np.dtype(
    {
        "names": ["version", "sections", "level", "least", "most"],
        "formats": [("u1", 2), "<u4", "<u2", "<f4", "<f4"],
        "offsets": [0, 4, 20, 36, 40],
        "itemsize": 4096,
    }
)
_SECTION = np.dtype(
    {
        "names": "count room capacity buckets block bucket_bytes steps full partial degree".split(),
        "formats": ["<u4", "<u4", "<u4", "<u4", "<f4", "<u2", "<u4", "<u4", "<u4", "<u2"],
        "offsets": [0, 4, 8, 12, 16, 20, 24, 32, 36, 40],
        "itemsize": 1024,
    }
)
_LEVELS = (("<f4", "<f4", "<f4"), ("<u2", "<f2", "<f2"), ("<u2", "<f2", "u1"))
"""Types of means, of scales and quaternions, and of harmonics, by compression level."""
_STEPS = 32_767
_SH_BOUND = 1.5
_MAX_DEGREE = 2


def read_splat_rows(path: Path, name: str, limits: SplatLimits) -> SplatRows:
    """Reads a `.splat` file in order. Raises as `splat_reading.read_splat_file`."""
    count, rest = divmod(path.stat().st_size, _SPLAT.itemsize)
    if rest:
        raise bad_splat(name, f"has {rest} bytes behind its {count} rows of {_SPLAT.itemsize}")
    check_count(name, count, limits)
    table = np.fromfile(path, _SPLAT)
    quats = (table["quats"].astype(np.float32) - 128) / np.float32(128)
    return _rows(table["means"], quats, table["scales"], table["rgba"], np.zeros((count, 0, 3), np.float32))


def read_ksplat(path: Path, name: str, limits: SplatLimits) -> SplatRows:
    """Reads a `.ksplat` file by sections. Raises as `splat_reading.read_splat_file`."""
    content = np.memmap(path, np.uint8, "r") if path.stat().st_size else np.zeros(0, np.uint8)

    def take(at: int, kind: np.dtype[np.void] | str, count: int) -> NDArray[Any]:
        size = np.dtype(kind).itemsize * count
        if at + size > len(content):
            raise bad_splat(name, f"has {len(content)} bytes where its header asks for at least {at + size}")
        return np.frombuffer(content[at : at + size].tobytes(), kind)

    header = take(0, _HEADER, 1)[0]
    level = int(header["level"])
    if header["version"][0] != 0 or header["version"][1] < 1 or level >= len(_LEVELS):
        raise bad_splat(name, f"is .ksplat of version {header['version'].tolist()} with compression {level}")
    sections = take(_HEADER.itemsize, _SECTION, int(header["sections"]))
    check_count(name, sum(int(section["count"]) for section in sections), limits)
    if (degree := int(sections["degree"].max())) > _MAX_DEGREE:
        raise bad_splat(name, f"has harmonics of degree {degree}, at most {_MAX_DEGREE} is read")
    higher = SH_COUNTS[degree] - 1
    place, width, harmonic = _LEVELS[level]
    at, parts = _HEADER.itemsize + len(sections) * _SECTION.itemsize, []
    for section in ({key: section[key].item() for key in _SECTION.names or ()} for section in sections):
        sh_count = SH_COUNTS[section["degree"]] - 1
        fields = [("means", place, 3), ("scales", width, 3), ("quats", width, 4), ("rgba", "u1", 4)]
        layout = np.dtype([*fields, ("sh", harmonic, 3 * sh_count)])
        centers_at = at + 4 * section["partial"]
        rows_at = centers_at + section["bucket_bytes"] * section["buckets"]
        table = take(rows_at, layout, section["count"])
        means = table["means"].astype(np.float32)
        if level:
            centers = take(centers_at, "<f4", 3 * section["buckets"]).reshape(-1, 3)
            full = np.full(min(section["full"], len(centers)), section["capacity"])
            ends = np.cumsum(np.concatenate([full, take(at, "<u4", section["partial"])]))
            bucket = np.searchsorted(ends, np.arange(len(table)), side="right")
            if len(bucket) and bucket[-1] >= len(centers):
                raise bad_splat(name, "has Gaussians outside of its buckets")
            steps = section["steps"] or _STEPS
            means = (means - steps) * np.float32(section["block"] / 2 / steps) + centers[bucket]
        sh = np.zeros((len(table), higher, 3), np.float32)
        sh[:, :sh_count] = _harmonics(table["sh"].astype(np.float32), section["degree"])
        if harmonic == "u1":
            least, most = float(header["least"]) or -_SH_BOUND, float(header["most"]) or _SH_BOUND
            sh[:, :sh_count] = least + sh[:, :sh_count] / 255 * (most - least)
        parts.append(_rows(means, table["quats"], table["scales"], table["rgba"], sh))
        at = rows_at + layout.itemsize * section["room"]
    return SplatRows(**{key: np.concatenate([getattr(part, key) for part in parts]) for key in vars(parts[0])})


def _harmonics(stored: F32, degree: int) -> F32:
    """Reorders harmonics from bands, each by channel, to float32 [K, coefficients, 3]."""
    bands = np.split(stored, [9, 24], axis=1)[:degree]
    channels = [band.reshape(len(stored), 3, -1).transpose(0, 2, 1) for band in bands]
    return np.concatenate([np.zeros((len(stored), 0, 3), np.float32), *channels], axis=1)


def _rows(means: F32, quats: F32, scales: F32, rgba: NDArray[np.uint8], higher: F32) -> SplatRows:
    with np.errstate(divide="ignore", invalid="ignore"):
        log_scales = np.log(scales.astype(np.float32))
    colors = (rgba[:, :3].astype(np.float32) / 255 - 0.5) / np.float32(Y00)
    sh = np.concatenate([colors[:, None], higher], axis=1)
    return SplatRows(np.array(means), np.array(quats, np.float32), log_scales, logits(rgba[:, 3]), sh)
