"""Decodes pictures in the confined child of `untrusted.image_decoder`; imports are kept light."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.depth_files import DepthFile, read_depth, sample_depth
from fastsplat.service.capture.formats.image_io import (
    PhotoInfo,
    apply_orientation,
    load_opaque,
    load_upright,
    open_map,
    read_header,
)
from fastsplat.service.capture.formats.reduced_images import reduce, reduce_ids
from fastsplat_contract.errors import FastSplatError

DECODED, REFUSED = b"d", b"r"
"""First byte of an answer: bare pixels follow, or an error as JSON line."""


def decode_requests(
    request: Mapping[str, Any], answers: BinaryIO, error_of: Callable[[Exception], Mapping[str, Any] | None]
) -> None:
    """Answers one request per line of stdin until it is closed.

    A line is {"root", "name", "photo", "size", "kind"}: the folder, and the image or map in it; the photo's header as
    `PhotoInfo`; (width, height) of the answer; "rgb" (uint8 [H, W, 3]), "opaque" (uint8 [H, W]), "map" (uint16 [H, W]),
    "depth" (float32 [H, W], for the `DepthFile` in "depth"), or "header" (float64 [5]: width, height, orientation,
    focal_35mm and time, or NaN, of an image without a `PhotoInfo`).

    Args:
        answers: receives `DECODED` and the pixels, row by row, or `REFUSED` and an error.
        error_of: converts an expected exception to JSON; None for others.
    """
    settings = CaptureSettings(**request["settings"])
    for line in sys.stdin.buffer:
        file_request = json.loads(line)
        root, photo, size = Path(file_request["root"]), PhotoInfo(**file_request["photo"]), tuple(file_request["size"])
        pixels: NDArray[Any]
        try:
            if file_request["kind"] == "map":
                pixels = load_upright_map(root, file_request["name"], photo, size, settings)
            elif file_request["kind"] == "depth":
                pixels = sample_depth(read_depth(root, DepthFile(**file_request["depth"]), settings), size)
            elif file_request["kind"] == "header":
                header = read_header(root, file_request["name"], settings)
                numbers = header.width, header.height, header.orientation, header.focal_35mm, header.taken_at
                pixels = np.array(numbers, np.float64)  # None becomes NaN
            elif file_request["kind"] == "opaque":
                pixels = reduce(load_opaque(root, photo, settings), size)
            else:
                pixels = reduce(load_upright(root, photo, settings), size)
        except (FastSplatError, MemoryError, OSError) as error:
            details = error_of(error)
            if details is None:
                raise
            answers.write(REFUSED + json.dumps(details).encode() + b"\n")
        else:
            answers.write(DECODED)
            answers.write(np.ascontiguousarray(pixels).data)
        answers.flush()


def load_upright_map(
    root: Path, name: str, photo: PhotoInfo, size: tuple[int, int], settings: CaptureSettings
) -> NDArray[np.uint16]:
    """Decodes a map, turned upright if only the stored photo fits, reduced to `size`."""
    stored = open_map(root, name, settings)
    if stored.shape[1::-1] != photo.upright_size:
        stored = apply_orientation(stored, photo.orientation)
    return reduce_ids(stored, size)
