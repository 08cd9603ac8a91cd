"""Memory budget of answers, edits and opening scenes, admitted before allocation.

Estimates are of the peak of rendering and encoding beside the open scene, measured on the CPU backend with images of 4
and 16 megapixels and rounded up; a test compares them with a process's real peak.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

from fastsplat.service.common.call_scheduling import current_runner, wait_elsewhere
from fastsplat.service.scene.artefact.scene import Gaussians, Scene
from fastsplat.service.settings import CallSettings
from fastsplat_contract.errors import FastSplatError, LimitExceededError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.masks import Mask3dEncoding
from fastsplat_contract.photos.pictures import PictureKind

_POLL_S = 0.1
_FORGOTTEN_S = 5.0
"""A waiting call without a retry for this long has lost its turn."""
_SHARE_OF_ALL, _SHARE_OF_ONE = 0.5, 0.25

_FIXED_BYTES = 64 << 20
"""Bands of label probabilities, buffers of encoders."""
_PER_GAUSSIAN = 768
"""Features, projection and tiles of a Gaussian in one rendering, in bytes."""
_PER_MASK_PIXEL = 24
_PER_ENCODED_PIXEL = 1
_PER_EDITED_GAUSSIAN = 512
_EDITED_COPIES = 3
"""Copies of an edited scene: before and after an edit, and the PLY layout."""
_PER_MASKED_GAUSSIAN: Mapping[Mask3dEncoding, float] = {"bits": 2.0, "runs": 16.0, "indices": 16.0, "ply": 0.0}
_PER_PIXEL: Mapping[PictureKind, int] = {
    "rgb": 56, "overlay": 128, "relevancy": 136, "mask": 80, "label_map": 32, "depth": 48, "depth_picture": 128,
    "object_map": 32, "objects": 128, "normals": 160, "confidence": 160,
}  # fmt: skip


def picture_bytes(kind: PictureKind, posed: PosedCamera, gaussians: int) -> int:
    """Estimated peak of making one picture, in bytes."""
    return _FIXED_BYTES + _PER_PIXEL[kind] * _pixels(posed) + _PER_GAUSSIAN * gaussians


def masks_bytes(cameras: Iterable[PosedCamera], texts: int, gaussians: int) -> int:
    """Estimated peak of rendering masks of `texts` answers one by one, kept encoded, in bytes."""
    pixels = [_pixels(posed) for posed in cameras]
    largest = max(pixels, default=0)
    encoded = _PER_ENCODED_PIXEL * texts * sum(pixels)
    return _FIXED_BYTES + _PER_MASK_PIXEL * largest + _PER_GAUSSIAN * gaussians + encoded if pixels else 0


def mask3d_bytes(encoding: Mask3dEncoding, texts: int, gaussians: Gaussians) -> int:
    """Estimated size of Gaussian masks, including their computation, in bytes."""
    per_gaussian = _PER_MASKED_GAUSSIAN[encoding] if encoding != "ply" else 3 * _ply_row_bytes(gaussians)
    return int(texts * per_gaussian * len(gaussians))


def export_bytes(gaussians: Gaussians) -> int:
    """Estimated peak of exporting Gaussians to a file, in bytes."""
    return _FIXED_BYTES + 3 * _ply_row_bytes(gaussians) * len(gaussians)


def edit_bytes(scene: Scene, sources: Iterable[Scene]) -> int:
    """Estimated peak of an edit in bytes: copies, selection, and the new index.

    `sources` are the scenes that objects are inserted from, once per insertion.
    """
    scenes = [scene, *sources]
    gaussians = sum(len(scene.gaussians) for scene in scenes)
    return _FIXED_BYTES + _PER_EDITED_GAUSSIAN * gaussians + _EDITED_COPIES * sum(map(_weight, scenes))


@dataclass(frozen=True)
class _Waiting:
    """A call that waits for `size` bytes and retries."""

    size: int
    tried_at: float


class MemoryBudget:
    """First-come, first-served budget of the bytes held by all calls. Thread-safe.

    Limits of 0 in `settings` are derived from `machine_bytes`, this machine's or control group's memory.
    """

    def __init__(self, settings: CallSettings, machine_bytes: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._all = settings.answer_memory_bytes or int(_SHARE_OF_ALL * machine_bytes)
        self._largest = min(self._all, settings.request_memory_bytes or int(_SHARE_OF_ONE * machine_bytes))
        self._clock = clock
        self._lock = threading.Lock()
        self._reserved = 0
        self._waiting: dict[object, _Waiting] = {}  # in order of arrival
        self._cached: list[tuple[int, Callable[[], None]]] = []

    @property
    def reserved(self) -> int:
        return self._reserved

    @property
    def cached_bytes(self) -> int:
        """Bytes kept between calls, see `keep`."""
        return sum(size for size, _ in self._cached)

    def keep(self, size: int, drop: Callable[[], None]) -> bool:
        """Counts bytes that stay allocated between calls; False, uncounted, if there is no room.

        A call that needs their room calls `drop`, once, from any thread; it must not call this budget.
        """
        with self._lock:
            if self._reserved + self.cached_bytes + size > self._all:
                return False
            self._cached.append((size, drop))
            return True

    @contextmanager
    def reserve(self, size: int, field: str) -> Iterator[None]:
        """Context that may hold `size` bytes; waits for room, first come, first served.

        It waits without a thread if the call can retry. Small calls cannot starve a large one.

        Raises:
            LimitExceededError: more than one request may hold; names `field`.
            CancelledError, DeadlineExceededError, CallAgainError: as `wait_elsewhere`.
        """
        self.check(size, field)
        with self._reserved_for(size):
            yield

    def check(self, size: int, field: str) -> None:
        """Raises `LimitExceededError` if one request may not hold so many bytes."""
        if size > self._largest:
            raise LimitExceededError(
                f"the request would hold about {size / 2**20:.0f} MiB in memory",
                field=field,
                limit=f"{self._largest / 2**20:.0f} MiB for one request (FASTSPLAT_CALLS__REQUEST_MEMORY_BYTES)",
                hint="Ask for smaller or fewer views, for fewer texts or edits, or in several requests.",
            )

    @contextmanager
    def opening(self, size: int) -> Iterator[None]:
        """Context that opens a scene of `size` bytes; as `reserve`, limited by the whole budget.

        Afterwards the scene counts among the open ones.
        """
        if size > self._all:
            raise LimitExceededError(
                f"opening the scene would take about {size / 2**20:.0f} MiB of memory",
                field="scene",
                limit=f"{self._all / 2**20:.0f} MiB (FASTSPLAT_CALLS__ANSWER_MEMORY_BYTES)",
                hint="Train it with fewer Gaussians, or run the server on a machine with more memory.",
            )
        with self._reserved_for(size):
            yield

    @contextmanager
    def _reserved_for(self, size: int) -> Iterator[None]:
        call = current_runner() or object()
        while not self._take(call, size):
            try:
                wait_elsewhere(_POLL_S)
            except FastSplatError:
                with self._lock:
                    self._waiting.pop(call, None)
                raise
        try:
            yield
        finally:
            with self._lock:
                self._reserved -= size

    def _take(self, call: object, size: int) -> bool:
        with self._lock:
            now = self._clock()
            self._waiting = {
                known: waiting
                for known, waiting in self._waiting.items()
                if now - waiting.tried_at < _FORGOTTEN_S or known is call
            }
            before = 0
            for known, waiting in self._waiting.items():
                if known is call:
                    break
                before += waiting.size
            if self._reserved + self.cached_bytes + before + size > self._all:
                for _, drop in self._cached:
                    drop()
                self._cached.clear()
            if self._reserved + before + size > self._all:
                self._waiting[call] = _Waiting(size, now)
                return False
            self._waiting.pop(call, None)
            self._reserved += size
            return True


def _weight(scene: Scene) -> int:
    """Bytes of all per-Gaussian arrays."""
    objects = scene.objects
    parts = None if objects is None else objects.parts
    counts = [scene.evidence, objects and objects.membership, parts and parts.membership]
    held = [scene.gaussians, *(part for part in counts if part is not None)]
    return sum(array.nbytes for part in held for array in vars(part).values())


def _pixels(posed: PosedCamera) -> int:
    return posed.camera.width * posed.camera.height


def _ply_row_bytes(gaussians: Gaussians) -> int:
    """3DGS PLY: means, normals, harmonics, opacity, scales and rotation, float32."""
    return 4 * (3 + 3 + 3 * int(gaussians.sh.shape[1]) + 1 + 3 + 4)
