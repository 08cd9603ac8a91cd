"""Cache of surface views, shared by all surface exports of a version."""

from __future__ import annotations

import threading

from fastsplat.service.application.base.cache import LeastRecentlyUsed
from fastsplat.service.application.base.memory import MemoryBudget
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.surfaces.surface_views import BYTES_PER_PIXEL, SurfaceView, surface_views


class SurfaceCache:
    """Surface views of the last used version, until their memory is needed. Thread-safe."""

    def __init__(self, memory: MemoryBudget) -> None:
        self._memory = memory
        self._lock = threading.Lock()
        self._counted = False
        self._views: LeastRecentlyUsed[tuple[str, str], tuple[SurfaceView, ...]] = LeastRecentlyUsed(0)

    def views(self, scene_id: str, version: str, index: SceneIndex) -> tuple[SurfaceView, ...]:
        """Surface views of a version, cached if there is room; raises as `surface_views`."""
        views = self._views.get((scene_id, version), lambda: 1, lambda: surface_views(index))
        with self._lock:
            uncounted, self._counted = not self._counted, True
        largest = BYTES_PER_PIXEL * index.settings.surface_views * index.settings.surface_side**2
        if uncounted and not self._memory.keep(largest, self._drop):
            self._drop()
        return views

    def forget(self, scene_id: str) -> None:
        """Drops one scene."""
        self._views.drop(lambda key: key[0] == scene_id)

    def _drop(self) -> None:
        with self._lock:
            self._counted = False
        self._views.drop(lambda _: True)
