"""Reads PlayCanvas' SOG 2: a zip of WebP pictures, a pixel per Gaussian, with `meta.json`."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

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

_META = "meta.json"
_MAX_META_BYTES = 1 << 20
_SLACK_BYTES = 1 << 20
_ENTRIES_A_ROW = 64
_MOST_ENTRIES = 1 << 16
_CENTRAL_ENTRY = b"PK\x01\x02"


def is_sog(path: Path) -> bool:
    """Detects a zip with SOG's document and positions by the names in its last bytes."""
    with path.open("rb") as file:
        if file.read(4) != b"PK\x03\x04":
            return False
        file.seek(max(0, path.stat().st_size - (1 << 16)))
        names = {entry[42 : 42 + entry[24]] for entry in file.read().split(_CENTRAL_ENTRY)[1:] if len(entry) > 42}
    return {_META.encode(), b"means_l.webp"} <= names


def read_sog(path: Path, name: str, limits: SplatLimits) -> SplatRows:
    """Reads a SOG file; logits ±inf for bytes 0 and 255. Raises as `read_splat_file`."""
    try:
        with zipfile.ZipFile(path) as archive:
            meta = json.loads(_content(archive, _META, _MAX_META_BYTES))
            if meta.get("version") != 2:
                raise bad_splat(name, f"is SOG of version {str(meta.get('version', 1))[:20]}, only 2 is read")
            check_count(name, int(meta["count"]), limits)
            return _rows(archive, meta, int(meta["count"]))
    except (zipfile.BadZipFile, NotImplementedError, OSError, RuntimeError) as error:
        raise bad_splat(name, f"is no whole SOG file: {str(error)[:80]}") from error
    except (KeyError, TypeError, AttributeError, ValueError, IndexError, SyntaxError, OverflowError) as error:
        raise bad_splat(name, f"has parts that do not fit its meta.json: {str(error)[:80]}") from error


def _rows(archive: zipfile.ZipFile, meta: Mapping[str, Any], count: int) -> SplatRows:
    def pixels(group: str, index: int = 0) -> NDArray[np.uint8]:
        return _picture(archive, meta[group]["files"][index], 4 * count + _MOST_ENTRIES).reshape(-1, 4)[:count]

    def numbers(group: str, key: str, size: int) -> F32:
        values = np.array(meta[group][key], np.float32)
        if values.shape != (size,):
            raise ValueError(f"{group} has {key} of {values.shape} numbers")
        return values

    low, high = (pixels("means", index)[:, :3].astype(np.float32) for index in range(2))
    mins, maxs = numbers("means", "mins", 3), numbers("means", "maxs", 3)
    logs = mins + (low + 256 * high) / 65_535 * (maxs - mins)
    color = pixels("sh0")
    sh = numbers("sh0", "codebook", 256)[color[:, :3]][:, None]
    if "shN" in meta:
        labels = pixels("shN", 1).astype(np.intp)
        higher = SH_COUNTS[meta["shN"]["bands"]] - 1
        side = _ENTRIES_A_ROW * higher
        entries = _picture(archive, meta["shN"]["files"][0], side * (_MOST_ENTRIES // _ENTRIES_A_ROW))[..., :3]
        entries = entries.reshape(-1, higher, 3)[labels[:, 0] + 256 * labels[:, 1]]
        sh = np.concatenate([sh, numbers("shN", "codebook", 256)[entries]], axis=1)
    rows = SplatRows(
        means=np.sign(logs) * np.expm1(np.abs(logs)),
        quats=_quaternions(pixels("quats")),
        log_scales=numbers("scales", "codebook", 256)[pixels("scales")[:, :3]],
        logit_opacities=logits(color[:, 3]),
        sh=np.ascontiguousarray(sh),
    )
    if any(len(column) != count for column in vars(rows).values()):
        raise ValueError(f"fewer pixels than {count} Gaussians")
    return rows


def _quaternions(pixels: NDArray[np.uint8]) -> F32:
    """Unpacks quaternions w x y z, [G, 4]: smaller components, and 252 + the largest's index."""
    smaller = (pixels[:, :3] / np.float32(255) - np.float32(0.5)) * np.float32(np.sqrt(2))
    return smallest_three(np.clip(pixels[:, 3].astype(np.intp) - 252, 0, 3), smaller)


def _picture(archive: zipfile.ZipFile, name: str, most_pixels: int) -> NDArray[np.uint8]:
    """Decodes uint8 [H, W, 4]."""
    with Image.open(io.BytesIO(_content(archive, name, 4 * most_pixels + _SLACK_BYTES)), formats=("WEBP",)) as image:
        if image.width * image.height > most_pixels:
            raise ValueError(f"{name} has {image.width}×{image.height} pixels")
        return np.asarray(image.convert("RGBA"))


def _content(archive: zipfile.ZipFile, name: str, most_bytes: int) -> bytes:
    with archive.open(name) as file:
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise ValueError(f"{name} has more than {most_bytes} bytes")
    return content
