"""Reads depth maps of uploads: gray images, NumPy arrays, and Record3D's compressed floats.

Used only in the confined processes that check uploads and decode pictures.

LZFSE's decoder doubles its memory for as long as a stream asks, so block sizes are added up first.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.image_io import open_map, read_size, too_many_pixels
from fastsplat.service.common.optional_packages import LZFSE, needed
from fastsplat_contract.errors import CorruptImageError, InvalidInputError

ARRAY_SUFFIX, COMPRESSED_SUFFIX = ".npy", ".depth"
IMAGE_SUFFIXES = frozenset({".png", ".tif", ".tiff"})
_FARTHEST = 1_000.0  # scene units; beyond, no sensor measures
_UNITS = (1e-9, 1e3)
_SLACK_BYTES = 4_096
_LOW_CONFIDENCE = 0
"""ARKit: 0 low, 1 medium, 2 high (ARConfidenceLevel); Polycam stretches these over 0..255."""

_END, _PLAIN, _LZFSE, _LZVN = b"bvx$", b"bvx-", b"bvx2", b"bvxn"
_HINT = "Export the recording again."
_PAYLOAD_BITS = (1 << 20) - 1


@dataclass(frozen=True)
class DepthFile:
    """A depth map of an upload: camera z of every pixel."""

    path: str  # in the upload: 16-bit gray image, `.npy` array, or `.depth` (float32, LZFSE)
    unit: float  # scene units per stored unit
    size: tuple[int, int] | None = None  # (width, height) as stored, if the file itself does not say
    confidence: str | None = None  # path of ARKit's confidence map; pixels of the lowest level are unknown


def check_depth_unit(unit: Any, *, field: str) -> float:
    """Checks a depth unit.

    Raises:
        InvalidInputError: it is no number from 1e-9 to 1000.
    """
    if isinstance(unit, bool) or not isinstance(unit, int | float) or not _UNITS[0] <= unit <= _UNITS[1]:
        raise InvalidInputError(
            f"the depth unit is {str(unit)[:60]!r}",
            field=field,
            limit=f"{_UNITS[0]:g} to {_UNITS[1]:g}",
            hint="Say how many scene units one step of the depth maps is, e.g. 0.001 for millimeters.",
        )
    return float(unit)


def depth_size(root: Path, file: DepthFile, settings: CaptureSettings) -> tuple[int, int]:
    """Reads (width, height) of a depth map as stored, without its pixels.

    Raises:
        CorruptImageError: it is no image or no array of two dimensions.
        LimitExceededError: it has more than `max_image_pixels`.
    """
    suffix = PurePosixPath(file.path).suffix.lower()
    if suffix == ARRAY_SUFFIX:
        height, width = _open_array(root / file.path, file.path).shape[:2]
    elif suffix == COMPRESSED_SUFFIX:
        assert file.size is not None
        width, height = file.size
    else:
        return read_size(root, file.path, settings)
    if width * height > settings.max_image_pixels:
        raise too_many_pixels(file.path, f"{width}×{height}", settings)
    return int(width), int(height)


def read_depth(root: Path, file: DepthFile, settings: CaptureSettings) -> NDArray[np.float32]:
    """Reads a depth map in scene units, float32 [H, W].

    0 where unknown: not finite, not positive, farther than 1000 units, or of low confidence.

    Raises:
        CorruptImageError, LimitExceededError: as `depth_size`, and where the content is cut short or damaged.
        InvalidInputError: it has colors, or its confidence has another size.
    """
    width, height = depth_size(root, file, settings)
    suffix = PurePosixPath(file.path).suffix.lower()
    stored: NDArray[Any]
    if suffix == ARRAY_SUFFIX:
        stored = np.asarray(_open_array(root / file.path, file.path)).reshape(height, width)
    elif suffix == COMPRESSED_SUFFIX:
        stored = np.frombuffer(_decompressed(root, file.path, 4 * width * height), "<f4").reshape(height, width)
    else:
        stored = open_map(root, file.path, settings, depth=True)
    with np.errstate(over="ignore", invalid="ignore"):
        depth = (stored.astype(np.float64) * file.unit).astype(np.float32)
        depth[~((depth > 0) & (depth <= _FARTHEST))] = 0.0  # false for NaN too
    if file.confidence is not None:
        depth[_confidence(root, file.confidence, (width, height), settings) <= _LOW_CONFIDENCE] = 0.0
    return depth


def sample_depth(depth: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.float32]:
    """Resizes to (width, height) by nearest neighbor, so that surfaces are not mixed."""
    if depth.shape[1::-1] == size:
        return depth
    return np.asarray(cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST_EXACT), np.float32)


def _open_array(path: Path, name: str) -> NDArray[Any]:
    """Maps a `.npy` file [H, W] into memory; its length is checked against its header."""
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, OSError, EOFError, SyntaxError, OverflowError, TypeError) as error:
        raise CorruptImageError(
            f"{name} is not a readable array: {error}"[:300], field=name, hint="Save it again by numpy.save."
        ) from error
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fu" or math.prod(array.shape) == 0:
        raise CorruptImageError.of(name, "is not an array of depths", "Save float or unsigned numbers [H, W].")
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[..., 0]
    if array.ndim != 2:
        raise CorruptImageError.of(name, f"has the shape {array.shape}", "Save one number per pixel, [H, W].")
    return np.asarray(array)


def _confidence(root: Path, name: str, size: tuple[int, int], settings: CaptureSettings) -> NDArray[np.integer]:
    if PurePosixPath(name).suffix.lower() in IMAGE_SUFFIXES:
        levels = open_map(root, name, settings)
        if levels.shape[1::-1] != size:
            raise InvalidInputError.of(
                name,
                f"has {levels.shape[1]}×{levels.shape[0]} pixels, its depth map {size[0]}×{size[1]}",
                "Send confidence maps of exactly their depth map's size, or none.",
            )
        return levels
    return np.frombuffer(_decompressed(root, name, size[0] * size[1]), np.uint8).reshape(size[1], size[0])


def _decompressed(root: Path, name: str, expected_bytes: int) -> bytes:
    path = root / name
    if path.stat().st_size > expected_bytes + _SLACK_BYTES:
        raise CorruptImageError.of(
            name,
            f"has {path.stat().st_size} bytes, more than it may unpack to",
            "Export the recording again.",
            f"{expected_bytes} bytes",
        )
    packed = path.read_bytes()
    if len(packed) == expected_bytes:  # some exports do not compress
        return packed
    return _unpack_lzfse(packed, name, expected_bytes)


def _unpack_lzfse(packed: bytes, name: str, expected_bytes: int) -> bytes:
    """Unpacks exactly `expected_bytes`; errors name the file `name`.

    Raises:
        CorruptImageError: cut short, damaged, no LZFSE, or of another size.
        MissingPackageError: the decoder's package is not installed.
    """
    size = _unpacked_bytes(packed)
    if size is None:
        raise CorruptImageError(f"{name} is cut short or damaged", field=name, hint=_HINT)
    if size != expected_bytes:
        raise _wrong_size(name, size, expected_bytes)
    with needed(LZFSE, "the depth of Record3D's recordings", name):
        import lzfse

    try:
        content = bytes(lzfse.decompress(packed))
    except (lzfse.error, MemoryError) as error:  # on damaged content it asks for ever more memory
        raise CorruptImageError(f"{name} is damaged: {error}", field=name, hint=_HINT) from error
    if len(content) != expected_bytes:
        raise _wrong_size(name, len(content), expected_bytes)
    return content


def _unpacked_bytes(packed: bytes) -> int | None:
    """Adds up the sizes in block headers; None if the stream ends early."""
    at, total = 0, 0
    while True:
        kind = packed[at : at + 4]
        if kind == _END:
            return total
        header = packed[at : at + 32]
        if len(header) < 12:
            return None
        raw = struct.unpack_from("<I", header, 4)[0]
        total += raw
        if kind == _PLAIN:
            at += 8 + raw
        elif kind == _LZVN:
            at += 12 + struct.unpack_from("<I", header, 8)[0]
        elif kind == _LZFSE and len(header) == 32:
            literals, matches, sizes = struct.unpack_from("<3Q", header, 8)
            payload = (literals >> 20 & _PAYLOAD_BITS) + (matches >> 40 & _PAYLOAD_BITS)
            at += max(32, sizes & 0xFFFFFFFF) + payload
        else:
            return None


def _wrong_size(name: str, size: int, expected_bytes: int) -> CorruptImageError:
    return CorruptImageError.of(
        name, f"unpacks to {size} bytes", _HINT, f"{expected_bytes} bytes, by the size in the metadata"
    )
