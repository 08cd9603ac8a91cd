"""LRU cache of object maps, bounded by bytes."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable

import numpy as np
from numpy.typing import NDArray

ObjectMap = NDArray[np.uint16]

KEPT_MAP_BYTES = 32 << 20
"""Limit per open scene: 8 maps of 1920×1080 pixels, or one of 4096×4096."""


class KeptMaps:
    """LRU cache of uint16 [H, W] maps, up to `KEPT_MAP_BYTES` together; thread-safe."""

    def __init__(self) -> None:
        self._maps: OrderedDict[Hashable, ObjectMap] = OrderedDict()
        self._bytes = 0
        self._lock = threading.Lock()

    @property
    def nbytes(self) -> int:
        return self._bytes

    def get(self, key: Hashable, draw: Callable[[], ObjectMap]) -> ObjectMap:
        """Returns the map of `key`, drawn on a miss; two threads may draw it twice."""
        with self._lock:
            if key in self._maps:
                self._maps.move_to_end(key)
                return self._maps[key]
        drawn = draw()
        with self._lock:
            if key not in self._maps and drawn.nbytes <= KEPT_MAP_BYTES:
                self._maps[key] = drawn
                self._bytes += drawn.nbytes
                while self._bytes > KEPT_MAP_BYTES:
                    self._bytes -= self._maps.popitem(last=False)[1].nbytes
        return drawn
