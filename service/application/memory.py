"""Memory of answers, admitted before it is allocated: estimated from the arguments, bounded for each and for all.

The estimates are of what rendering and encoding hold at their peak beside the open scene, measured on the CPU
backend with images of 4 and 16 million pixels and rounded up; a test compares them with a process's real peak.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from fastsplat.service.common.call_scheduling import wait_elsewhere
from fastsplat.service.scene import Gaussians
from fastsplat.service.settings import CallSettings
from fastsplat_contract.camera import PosedCamera
from fastsplat_contract.errors import LimitExceededError
from fastsplat_contract.masks import Mask3dEncoding
from fastsplat_contract.queries import PictureKind

_POLL_S = 0.1
_SHARE_OF_ALL, _SHARE_OF_ONE = 0.5, 0.25
_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")

_FIXED_BYTES = 64 << 20
"""Bands of label probabilities, buffers of encoders."""
_PER_GAUSSIAN = 768
"""Bytes of a Gaussian's features, projection and tiles, in one rendering."""
_PER_MASK_PIXEL = 80
_PER_ENCODED_PIXEL = 1
_PER_MASKED_GAUSSIAN: Mapping[Mask3dEncoding, float] = {"bits": 2.0, "runs": 16.0, "indices": 16.0, "ply": 0.0}
_PER_PIXEL: Mapping[PictureKind, int] = {
    "rgb": 56,
    "overlay": 128,
    "relevancy": 136,
    "mask": 80,
    "label_map": 32,
    "depth": 48,
    "depth_picture": 128,
}


def picture_bytes(kind: PictureKind, posed: PosedCamera, gaussians: int) -> int:
    """Estimated peak of making one picture, in bytes.

    Args:
        kind: what it shows.
        posed: from where.
        gaussians: of the scene.
    """
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


class MemoryBudget:
    """Bytes that answers hold together in this process. Safe from any thread.

    Args:
        settings: the limits; those that are 0 follow from the machine's memory, or its control group's.
        machine_bytes: that memory.
    """

    def __init__(self, settings: CallSettings, machine_bytes: int) -> None:
        self._all = settings.answer_memory_bytes or int(_SHARE_OF_ALL * machine_bytes)
        self._one = min(self._all, settings.request_memory_bytes or int(_SHARE_OF_ONE * machine_bytes))
        self._lock = threading.Lock()
        self._reserved = 0

    @property
    def reserved(self) -> int:
        """Bytes that are reserved now."""
        return self._reserved

    @contextmanager
    def reserve(self, size: int, field: str) -> Iterator[None]:
        """A block that may hold so many bytes; waits until others have released enough, without a thread if the call
        can be made again.

        Args:
            size: bytes.
            field: of the request, for what is too large ever to be admitted.

        Raises:
            LimitExceededError: more than one request may hold.
            CancelledError, DeadlineExceededError, CallAgainError: as `wait_elsewhere`.
        """
        if size > self._one:
            raise LimitExceededError(
                f"the answer would hold about {size / 2**20:.0f} MiB in memory",
                field=field,
                limit=f"{self._one / 2**20:.0f} MiB for one request (FASTSPLAT_CALLS__REQUEST_MEMORY_BYTES)",
                hint="Ask for smaller or fewer views, for fewer texts, or in several requests.",
            )
        while not self._take(size):
            wait_elsewhere(_POLL_S)
        try:
            yield
        finally:
            with self._lock:
                self._reserved -= size

    def _take(self, size: int) -> bool:
        with self._lock:
            if self._reserved + size > self._all:
                return False
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


def _pixels(posed: PosedCamera) -> int:
    return posed.camera.width * posed.camera.height


def _ply_row_bytes(gaussians: Gaussians) -> int:
    """3DGS PLY: means, normals, harmonics, opacity, scales and rotation, float32."""
    return 4 * (3 + 3 + 3 * int(gaussians.sh.shape[1]) + 1 + 3 + 4)
