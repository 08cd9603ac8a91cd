"""Single photos that come with a request: decoded by a confined child, upright and reduced. A child serves one request,
so that no caller's photo harms another's; a spare one is started ahead."""

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

from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.capture.untrusted.image_decoder import ImageDecoder
from fastsplat.service.capture.untrusted.image_decoding import reduced_size

DECODER_BYTES = 96 << 20
"""Of a child that waits, at most."""


@dataclass(frozen=True)
class SentPhoto:
    """A decoded photo.

    Attributes:
        pixels: uint8 [H, W, 3], upright, reduced.
        size: width and height before it was reduced, upright.
        focal: focal length over the longer side, as its metadata say; None where they do not.
        taken_at: when it was taken, seconds since 1970; None where its metadata do not say it with its time zone.
    """

    pixels: NDArray[np.uint8]
    size: tuple[int, int]
    focal: float | None
    taken_at: float | None = None


class SparePhotoDecoder:
    """Decodes the photos of one request after the other, each by a child of its own. Threads may share it."""

    def __init__(self, settings: CaptureSettings) -> None:
        self._settings = settings
        self._lock = threading.Lock()
        self._spare: _Child | None = None
        self._closed = False

    def decode(self, photos: Sequence[bytes], max_side: int) -> tuple[SentPhoto, ...]:
        """Photos with at most `max_side` pixels on the longer side.

        Args:
            photos: image files; errors name them as "photos[0]" and so on.

        Raises:
            CorruptImageError, LimitExceededError, ResourceError: as `ImageDecoder.photo`.
        """
        with self._lock:
            child, self._spare = self._spare, None
        child = child or _Child(self._settings)
        try:
            return child.decode(photos, max_side)
        finally:
            child.close()

    def prepare(self) -> bool:
        """Start a child for the next request, if none is waiting; whether one was started. On a thread that lives on:
        the child ends with the thread that started it."""
        with self._lock:
            if self._spare is not None or self._closed:
                return False
            self._spare = _Child(self._settings)
            return True

    def drop(self) -> None:
        """End the child that waits; a later request starts one."""
        with self._lock:
            child, self._spare = self._spare, None
        if child is not None:
            child.close()

    def close(self) -> None:
        """End the child that waits, and start no other ahead."""
        with self._lock:
            self._closed = True
        self.drop()


class _Child:
    """A decoder with a folder of its own that it reads photos from."""

    def __init__(self, settings: CaptureSettings) -> None:
        self._settings = settings
        self._folder = Path(tempfile.mkdtemp(prefix="fastsplat-photos-"))
        self._remove = weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)
        self._photos = self._folder / "photos"
        own = self._folder / "decoder"
        self._photos.mkdir()
        own.mkdir()
        self._decoder = ImageDecoder(own, (self._photos,), settings)

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
