"""Decodes photos sent with a request in a confined child, upright and reduced.

A child serves one request, so that photos of different callers stay apart; a spare one is started ahead.
"""

from __future__ import annotations

import shutil
import tempfile
import threading
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.reduced_images import reduced_size
from fastsplat.service.capture.untrusted.image_decoder import ImageDecoder

DECODER_BYTES = 96 << 20  # of a waiting child, at most


@dataclass(frozen=True)
class SentPhoto:
    """A decoded photo."""

    pixels: NDArray[np.uint8]  # [H, W, 3], upright, reduced
    size: tuple[int, int]  # width and height before reduction, upright
    focal: float | None  # over the longer side, by metadata
    taken_at: float | None = None  # seconds since 1970; None without a time zone


class SparePhotoDecoder:
    """Decodes the photos of each request in a child of its own. Thread-safe."""

    def __init__(self, settings: CaptureSettings) -> None:
        self._settings = settings
        self._lock = threading.Lock()
        self._spare: _Child | None = None
        self._closed = False

    def decode(self, photos: Sequence[bytes], max_side: int) -> tuple[SentPhoto, ...]:
        """Decodes image files, at most `max_side` pixels on the longer side.

        Errors are those of `ImageDecoder.photo` and name files "photos[0]" etc.
        """
        with self._lock:
            child, self._spare = self._spare, None
        child = child or _Child(self._settings)
        try:
            return child.decode(photos, max_side)
        finally:
            child.close()

    def prepare(self) -> bool:
        """Starts a spare child unless one is waiting; returns whether it did.

        Call it on a long-lived thread: the child ends with the thread that started it.
        """
        with self._lock:
            if self._spare is not None or self._closed:
                return False
            self._spare = _Child(self._settings)
            return True

    def drop(self) -> None:
        """Ends the spare child; a later request starts one."""
        with self._lock:
            child, self._spare = self._spare, None
        if child is not None:
            child.close()

    def close(self) -> None:
        """Ends the spare child for good."""
        with self._lock:
            self._closed = True
        self.drop()


class _Child:
    """A decoder with its own folder of photos."""

    def __init__(self, settings: CaptureSettings) -> None:
        self._settings = settings
        self._folder = Path(tempfile.mkdtemp(prefix="fastsplat-photos-"))
        self._remove = weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)
        self._photos = self._folder / "photos"
        decoder_folder = self._folder / "decoder"
        self._photos.mkdir()
        decoder_folder.mkdir()
        self._decoder = ImageDecoder(decoder_folder, (self._photos,), settings)

    def decode(self, photos: Sequence[bytes], max_side: int) -> tuple[SentPhoto, ...]:
        decoded = []
        for number, content in enumerate(photos):
            name = f"photos[{number}]"
            (self._photos / name).write_bytes(content)
            info = self._decoder.header(self._photos, name)
            size = reduced_size(*info.upright_size, max_side)
            pixels = self._decoder.photo(self._photos, info, size)
            decoded.append(SentPhoto(pixels, info.upright_size, info.focal_of_side, info.taken_at))
            (self._photos / name).unlink()
        return tuple(decoded)

    def close(self) -> None:
        self._decoder.__exit__(None, None, None)
        self._remove()
