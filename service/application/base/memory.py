"""Memory budget of answers, edits and scenes that open: estimated from the arguments, and admitted before it is
allocated.

The estimates are of what rendering and encoding hold at their peak beside the open scene, measured on the CPU
backend with images of 4 and 16 million pixels and rounded up; a test compares them with a process's real peak.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from fastsplat.service.common.call_scheduling import current_runner, wait_elsewhere
from fastsplat.service.scene.artefact.scene import Gaussians, Scene
from fastsplat.service.settings import CallSettings
from fastsplat_contract.errors import FastSplatError, LimitExceededError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.masks import Mask3dEncoding
from fastsplat_contract.photos.pictures import PictureKind

_POLL_S = 0.1
_FORGOTTEN_S = 5.0
"""Who waits and has not tried again for so long has left, or is out of turn."""
_SHARE_OF_ALL, _SHARE_OF_ONE = 0.5, 0.25
_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")

_FIXED_BYTES = 64 << 20
"""Bands of label probabilities, buffers of encoders."""
_PER_GAUSSIAN = 768
"""Bytes of a Gaussian's features, projection and tiles, in one rendering."""
_PER_MASK_PIXEL = 24
_PER_ENCODED_PIXEL = 1
_PER_EDITED_GAUSSIAN = 512
_EDITED_COPIES = 3
"""Each edit of a request copies what it changes; the copy before may be there still, and the PLY file is laid out."""
_PER_MASKED_GAUSSIAN: Mapping[Mask3dEncoding, float] = {"bits": 2.0, "runs": 16.0, "indices": 16.0, "ply": 0.0}
_PER_PIXEL: Mapping[PictureKind, int] = {
    "rgb": 56,
    "overlay": 128,
    "relevancy": 136,
    "mask": 80,
    "label_map": 32,
    "depth": 48,
    "depth_picture": 128,
    "thing_map": 32,
    "things": 128,
    "normals": 160,
    "confidence": 160,
}


def picture_bytes(kind: PictureKind, posed: PosedCamera, gaussians: int) -> int:
    """Estimated peak of making one picture, in bytes."""
    return _FIXED_BYTES + _PER_PIXEL[kind] * _pixels(posed) + _PER_GAUSSIAN * gaussians


def masks_bytes(cameras: Iterable[PosedCamera], texts: int, gaussians: int) -> int:
    """Estimated peak of drawing masks one after the other and keeping them encoded, in bytes.

    Args:
        cameras: the views.
        texts: how many answers are drawn in each.
        gaussians: of the scene.
    """
    pixels = [_pixels(posed) for posed in cameras]
    largest = max(pixels, default=0)
    encoded = _PER_ENCODED_PIXEL * texts * sum(pixels)
    return _FIXED_BYTES + _PER_MASK_PIXEL * largest + _PER_GAUSSIAN * gaussians + encoded if pixels else 0


def mask3d_bytes(encoding: Mask3dEncoding, texts: int, gaussians: Gaussians) -> int:
    """Estimated size of masks of Gaussians, with what making them needs, in bytes."""
    per_gaussian = _PER_MASKED_GAUSSIAN[encoding] if encoding != "ply" else 3 * _ply_row_bytes(gaussians)
    return int(texts * per_gaussian * len(gaussians))


def export_bytes(gaussians: Gaussians) -> int:
    """Estimated peak of writing Gaussians into a file for other programs, in bytes."""
    return _FIXED_BYTES + 3 * _ply_row_bytes(gaussians) * len(gaussians)


def edit_bytes(scene: Scene, sources: Iterable[Scene]) -> int:
    """Estimated peak of editing a scene: the copy of what changes, what choosing its Gaussians needs, and the index of
    the result, in bytes.

    Args:
        scene: as it is.
        sources: the scenes that things are inserted from, as often as that is done.
    """
    scenes = [scene, *sources]
    gaussians = sum(len(one.gaussians) for one in scenes)
    return _FIXED_BYTES + _PER_EDITED_GAUSSIAN * gaussians + _EDITED_COPIES * sum(map(_weight, scenes))


@dataclass(frozen=True)
class _Waiting:
    """A call that waits for so many bytes; calls that are made again try again."""

    size: int
    tried_at: float


class MemoryBudget:
    """Budget of the bytes that calls hold together in this process, first come, first served. Safe from any thread.

    Args:
        settings: the limits; those that are 0 follow from the machine's memory, or its control group's.
        machine_bytes: that memory.
        clock: seconds.
    """

    def __init__(self, settings: CallSettings, machine_bytes: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._all = settings.answer_memory_bytes or int(_SHARE_OF_ALL * machine_bytes)
        self._one = min(self._all, settings.request_memory_bytes or int(_SHARE_OF_ONE * machine_bytes))
        self._clock = clock
        self._lock = threading.Lock()
        self._reserved = 0
        self._waiting: dict[object, _Waiting] = {}  # in the order in which they came
        self._kept: list[tuple[int, Callable[[], None]]] = []

    @property
    def reserved(self) -> int:
        """Bytes that are reserved now."""
        return self._reserved

    @property
    def kept(self) -> int:
        """Bytes that are kept between calls now, see `keep`."""
        return sum(size for size, _ in self._kept)

    def keep(self, size: int, drop: Callable[[], None]) -> bool:
        """Count bytes that stay allocated between calls, until a call needs their room: that call lets go of them.

        Args:
            size: bytes.
            drop: lets go of them; called once, from any thread, and calls nothing of this budget.

        Returns:
            Whether there is room; otherwise nothing is counted, and nothing is to be kept.
        """
        with self._lock:
            if self._reserved + self.kept + size > self._all:
                return False
            self._kept.append((size, drop))
            return True

    @contextmanager
    def reserve(self, size: int, field: str) -> Iterator[None]:
        """A block that may hold so many bytes; waits until others have released enough, without a thread if the call
        can be made again. Who comes later waits until there is room for those before, too, so that many small calls
        never keep a large one waiting.

        Args:
            size: bytes.
            field: of the request, for what is too large ever to be admitted.

        Raises:
            LimitExceededError: more than one request may hold.
            CancelledError, DeadlineExceededError, CallAgainError: as `wait_elsewhere`.
        """
        self.check(size, field)
        with self._reserved_for(size):
            yield

    def check(self, size: int, field: str) -> None:
        """Return if one request may hold so many bytes. Raises `LimitExceededError`: it may not."""
        if size > self._one:
            raise LimitExceededError(
                f"the request would hold about {size / 2**20:.0f} MiB in memory",
                field=field,
                limit=f"{self._one / 2**20:.0f} MiB for one request (FASTSPLAT_CALLS__REQUEST_MEMORY_BYTES)",
                hint="Ask for smaller or fewer views, for fewer texts or edits, or in several requests.",
            )

    @contextmanager
    def opening(self, size: int) -> Iterator[None]:
        """A block that opens a scene of so many bytes, as `reserve`; afterwards the scene counts among the open ones.

        Raises:
            LimitExceededError: more than all requests together may hold.
            CancelledError, DeadlineExceededError, CallAgainError: as `wait_elsewhere`.
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
            if self._reserved + self.kept + before + size > self._all:
                for _, drop in self._kept:
                    drop()
                self._kept.clear()
            if self._reserved + before + size > self._all:
                self._waiting[call] = _Waiting(size, now)
                return False
            self._waiting.pop(call, None)
            self._reserved += size
            return True


def machine_bytes() -> int:
    """Memory that this process may have: the machine's, or the limit of its control group, if that is less."""
    limits = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    for path in _LIMITS:
        try:
            limits.append(int(Path(path).read_text()))
        except (OSError, ValueError):  # no such hierarchy, or "max"
            continue
    return min(limits)


def _weight(scene: Scene) -> int:
    """Bytes of the arrays that have a row for each Gaussian."""
    things = scene.things
    parts = None if things is None else things.parts
    counts = [scene.evidence, things and things.membership, parts and parts.membership]
    held = [scene.gaussians, *(part for part in counts if part is not None)]
    return sum(array.nbytes for part in held for array in vars(part).values())


def _pixels(posed: PosedCamera) -> int:
    return posed.camera.width * posed.camera.height


def _ply_row_bytes(gaussians: Gaussians) -> int:
    """3DGS PLY: means, normals, harmonics, opacity, scales and rotation, float32."""
    return 4 * (3 + 3 + 3 * int(gaussians.sh.shape[1]) + 1 + 3 + 4)
