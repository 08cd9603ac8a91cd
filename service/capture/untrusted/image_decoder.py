"""Decodes untrusted pictures in a confined child (`untrusted.image_decoding`) that returns bare pixels.

Exactly the requested number of bytes is read, so that nothing needs parsing again.
"""

from __future__ import annotations

import json
import math
import os
import select
import subprocess
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.depth_files import DepthFile
from fastsplat.service.capture.formats.image_io import PhotoInfo
from fastsplat.service.capture.untrusted.image_decoding import DECODED
from fastsplat.service.capture.untrusted.sandbox import decoder_error, error_from_json, kill_sandboxed, start_sandboxed
from fastsplat_contract.errors import ResourceError

_MAX_ERROR_BYTES = 1 << 16
_ENDING_S = 10.0
_HEADER_BYTES = 5 * 8
_MAX_FOCAL = 2_000.0


class ImageDecoder:
    """One child for all pictures of an upload; a context manager, for one thread.

    Args:
        folder: empty, for the child alone.
        roots: existing folders with pictures; the child can read no others.
        settings: limits of an image, with `validation_seconds` per picture and processor time `sfm_seconds` in all.
    """

    def __init__(self, folder: Path, roots: Sequence[Path], settings: CaptureSettings) -> None:
        self._folder = folder
        self._settings = settings
        request = {"roots": [str(root) for root in roots], "settings": settings.model_dump(mode="json")}
        self._process: subprocess.Popen[bytes] = start_sandboxed("decode", request, folder, settings)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        kill_sandboxed(self._process)

    def photo(self, root: Path, photo: PhotoInfo, size: tuple[int, int]) -> NDArray[np.uint8]:
        """Decodes a photo, upright, averaged down to `size` (width, height), [H, W, 3].

        Raises:
            CorruptImageError, LimitExceededError: as `check_image`.
            ResourceError: it exceeded its memory or time limit, or the child crashed.
        """
        pixels = self._decode("rgb", root, photo.path, photo, size, 3)
        return np.frombuffer(pixels, dtype=np.uint8).reshape(size[1], size[0], 3)

    def opaque(self, root: Path, photo: PhotoInfo, size: tuple[int, int]) -> NDArray[np.bool_] | None:
        """Decodes an opacity mask [H, W]; None if the header excludes transparency. Raises as `photo`."""
        if not photo.transparent:
            return None
        pixels = self._decode("opaque", root, photo.path, photo, size, 1)
        return np.asarray(np.frombuffer(pixels, dtype=np.uint8).reshape(size[1], size[0]) == 255)

    def header(self, root: Path, name: str) -> PhotoInfo:
        """Reads size, orientation, focal length and time of an unchecked image; raises as `photo`."""
        unknown = PhotoInfo(name, 1, 1, 1, "", 0.0)
        answer = self._decode("header", root, name, unknown, (1, 1), _HEADER_BYTES)
        width, height, orientation, focal, taken_at = np.frombuffer(answer, dtype=np.float64).tolist()
        pixels = width * height
        if not (1 <= pixels <= self._settings.max_image_pixels and 1 <= orientation <= 8 and 0 <= focal <= _MAX_FOCAL):
            raise ResourceError(f"decoding {name} went wrong", field=name, hint="Save it again as JPEG or PNG.")
        seconds = taken_at if math.isfinite(taken_at) else None
        return PhotoInfo(name, int(width), int(height), int(orientation), "", focal, taken_at=seconds)

    def ids(self, root: Path, name: str, photo: PhotoInfo, size: tuple[int, int]) -> NDArray[np.uint16]:
        """Decodes a label map or mask, upright, sampled to `size` (width, height), [H, W].

        Raises as `photo`, and `InvalidInputError` for colors instead of ids.
        """
        pixels = self._decode("map", root, name, photo, size, 2)
        return np.frombuffer(pixels, dtype=np.uint16).reshape(size[1], size[0])

    def depth(self, root: Path, file: DepthFile, photo: PhotoInfo, size: tuple[int, int]) -> NDArray[np.float32]:
        """Decodes a depth map in scene units, 0 where unknown, sampled to `size`, [H, W].

        Raises as `read_depth` and `photo`.
        """
        pixels = self._decode("depth", root, file.path, photo, size, 4, asdict(file))
        return np.frombuffer(pixels, dtype=np.float32).reshape(size[1], size[0])

    def _decode(
        self,
        kind: Literal["rgb", "opaque", "map", "depth", "header"],
        root: Path,
        name: str,
        photo: PhotoInfo,
        size: tuple[int, int],
        pixel_bytes: int,
        depth: dict[str, Any] | None = None,
    ) -> bytearray:
        request = {"kind": kind, "root": str(root), "name": name, "photo": asdict(photo), "size": size, "depth": depth}
        deadline = time.monotonic() + self._settings.validation_seconds
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            self._process.stdin.flush()
        except BrokenPipeError as error:
            raise self._ended() from error
        if self._receive(1, name, deadline) == DECODED:
            return self._receive(size[0] * size[1] * pixel_bytes, name, deadline)
        line = bytearray()
        while not line.endswith(b"\n") and len(line) < _MAX_ERROR_BYTES:
            line += self._receive(1, name, deadline)
        raise error_from_json(json.loads(line))

    def _receive(self, count: int, name: str, deadline: float) -> bytearray:
        assert self._process.stdout is not None
        buffer, done = bytearray(count), 0
        # Bypasses the buffered reader, which would consume what select is to see.
        pipe = self._process.stdout.fileno()
        while done < count:
            if not select.select([pipe], [], [], max(0.0, deadline - time.monotonic()))[0]:
                raise ResourceError(
                    f"decoding {name} took too long",
                    field=name,
                    limit=f"{self._settings.validation_seconds} s",
                    hint="Send a smaller version.",
                )
            length = os.readv(pipe, [memoryview(buffer)[done:]])
            if not length:
                raise self._ended()
            done += length
        return buffer

    def _ended(self) -> Exception:
        try:
            status = self._process.wait(_ENDING_S)
        except subprocess.TimeoutExpired:  # it closed its pipes but lives on
            status = kill_sandboxed(self._process)
        return decoder_error(status, self._folder, self._settings)
