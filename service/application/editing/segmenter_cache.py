"""Cache of the segmenter and its image embeddings, until its memory is needed."""

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
"""Cached view embeddings (LRU), about 4 MiB each."""

_OPEN_BYTES = 768 << 20
"""MobileSAM after its first pictures: 690 MiB measured, mostly activations."""
_EMBEDDING_BYTES = 4 << 20
"""One picture: 256 channels of 64×64, float32."""

_Key = tuple[int, Camera, bytes]


@dataclass
class OpenSegmenter:
    """Segmenter with an LRU cache of `limit` view embeddings. Thread-safe."""

    segmenter: Segmenter
    limit: int
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _embeddings: OrderedDict[_Key, tuple[weakref.ref[Gaussians], Any]] = field(default_factory=OrderedDict)

    def embedding(self, gaussians: Gaussians, posed: PosedCamera, picture: Callable[[], NDArray[np.uint8]]) -> Any:
        """Segmenter embedding of these Gaussians, rendered from a camera."""
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
    """Lazily opened segmenter of `settings.perception`, counted by `memory`. Thread-safe."""

    def __init__(self, settings: Settings, memory: MemoryBudget) -> None:
        self._settings = settings
        self._memory = memory
        self._lock = threading.Lock()
        self._open: OpenSegmenter | None = None
        self._counted = False

    @property
    def bytes(self) -> int:
        """Estimated maximum size."""
        return _OPEN_BYTES + _KEPT_VIEWS * _EMBEDDING_BYTES

    @contextmanager
    def used(self) -> Iterator[None]:
        """Context for reserving `bytes` and using the segmenter, kept open if there is room."""
        try:
            yield
        finally:
            with self._lock:
                keep = self._open is not None and not self._counted
                self._counted = self._counted or keep
            if keep and not self._memory.keep(self.bytes, self.drop):
                self.drop()

    def get(self) -> OpenSegmenter:
        """The segmenter, opened if necessary; raises `ModelUnavailableError` for missing or damaged files."""
        from fastsplat.service.perception.segmenters.open_segmenter import open_segmenter

        with self._lock:
            if self._open is None:
                segmenter = open_segmenter(self._settings.perception, self._settings.models)
                self._open = OpenSegmenter(segmenter, _KEPT_VIEWS)
            return self._open

    def drop(self) -> None:
        """Releases the segmenter; current users keep their reference."""
        with self._lock:
            self._open, self._counted = None, False
