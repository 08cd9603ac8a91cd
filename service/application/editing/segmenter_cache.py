"""Cache of the segmenter and its image embeddings between edits, until others need its memory."""

from __future__ import annotations

import threading
import weakref
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.application.base.memory import MemoryBudget
from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.settings import Settings
from fastsplat_contract.geometry.camera import Camera, PosedCamera

if TYPE_CHECKING:  # onnxruntime loads with the first prompt
    from fastsplat.service.perception.results import Segmenter

_KEPT_VIEWS = 16
"""Views of which the segmenter's answer to the picture is kept for the next prompt, about 4 MiB each; the least
recently used leave first."""

_OPEN_BYTES = 768 << 20
"""Of MobileSAM after its first pictures, measured: 690 MiB, nearly all of it room for what its layers compute."""
_EMBEDDING_BYTES = 4 << 20
"""Of one picture: 256 channels of 64×64."""

_Key = tuple[int, Camera, bytes]


@dataclass
class OpenSegmenter:
    """A segmenter with a cache of its embeddings of rendered views. Threads may share it.

    Attributes:
        segmenter: answers prompts.
        limit: how many pictures are remembered.
    """

    segmenter: Segmenter
    limit: int
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _embeddings: OrderedDict[_Key, tuple[weakref.ref[Gaussians], Any]] = field(default_factory=OrderedDict)

    def embedding(self, gaussians: Gaussians, posed: PosedCamera, picture: Callable[[], NDArray[np.uint8]]) -> Any:
        """What the segmenter needs to know of the picture of these Gaussians from that camera."""
        key = (id(gaussians), posed.camera, posed.world_from_camera.tobytes())
        with self._lock:
            known = self._embeddings.get(key)
            if known is not None and known[0]() is gaussians:
                self._embeddings.move_to_end(key)
                return known[1]
        made = self.segmenter.embed(picture())
        with self._lock:
            self._embeddings[key] = (weakref.ref(gaussians), made)
            while len(self._embeddings) > self.limit:
                self._embeddings.popitem(last=False)
        return made


class SegmenterCache:
    """Cache of the segmenter that `settings.perception` names, opened by the first prompt. Threads may share it.

    Args:
        settings: which one, where its files are, and how many pictures it remembers.
        memory: counts what it holds, while it is used and between.
    """

    def __init__(self, settings: Settings, memory: MemoryBudget) -> None:
        self._settings = settings
        self._memory = memory
        self._lock = threading.Lock()
        self._open: OpenSegmenter | None = None
        self._counted = False

    @property
    def bytes(self) -> int:
        """What it holds at most, by estimate."""
        return _OPEN_BYTES + _KEPT_VIEWS * _EMBEDDING_BYTES

    @contextmanager
    def used(self) -> Iterator[None]:
        """A block that reserves `bytes` inside and uses the segmenter; afterwards it stays open if there is room."""
        try:
            yield
        finally:
            with self._lock:
                keep = self._open is not None and not self._counted
                self._counted = self._counted or keep
            if keep and not self._memory.keep(self.bytes, self.drop):
                self.drop()

    def get(self) -> OpenSegmenter:
        """The segmenter, opened now if it is not.

        Raises:
            ModelUnavailableError: its files are not in the model directory, damaged, or break its contract.
        """
        from fastsplat.service.perception.segmenters.open_segmenter import open_segmenter

        with self._lock:
            if self._open is None:
                segmenter = open_segmenter(self._settings.perception, self._settings.models)
                self._open = OpenSegmenter(segmenter, _KEPT_VIEWS)
            return self._open

    def drop(self) -> None:
        """Let go of it; who uses it keeps it."""
        with self._lock:
            self._open, self._counted = None, False
