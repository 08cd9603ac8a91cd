"""Size-bounded LRU cache of costly values, each made once."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class LeastRecentlyUsed(Generic[K, V]):
    """LRU cache of up to `budget` bytes, or of one larger value. Thread-safe.

    Concurrent requests for a missing value wait for one of them to make it; users of an evicted value keep it.
    """

    def __init__(self, budget: int) -> None:
        self.budget = budget
        self._lock = threading.Lock()
        self._slots: OrderedDict[K, _Slot[V]] = OrderedDict()

    def get(self, key: K, size: Callable[[], int], make: Callable[[], V]) -> V:
        """Value of `key`, made if missing after evicting for `size()` bytes; failures are not cached."""
        with self._lock:
            slot = self._slots.setdefault(key, _Slot())
            self._slots.move_to_end(key)
        with slot.lock:
            if not slot.filled:
                try:
                    slot.size = size()
                    self._make_room(slot)
                    slot.value = make()
                except BaseException:
                    self._drop(key, slot)
                    raise
                slot.filled = True
                self._make_room(slot)  # others may have been added meanwhile
            return slot.value

    def drop(self, unwanted: Callable[[K], bool]) -> None:
        """Removes all keys for which `unwanted` is true."""
        with self._lock:
            for key in [key for key in self._slots if unwanted(key)]:
                del self._slots[key]

    @property
    def bytes(self) -> int:
        """Total size of the cached values."""
        with self._lock:
            return sum(slot.size for slot in self._slots.values())

    def __len__(self) -> int:
        with self._lock:
            return len(self._slots)

    def _make_room(self, newest: _Slot[V]) -> None:
        with self._lock:
            total = sum(slot.size for slot in self._slots.values())
            for key, slot in list(self._slots.items()):
                if total <= self.budget:
                    return
                if slot is not newest and slot.filled:
                    del self._slots[key]
                    total -= slot.size

    def _drop(self, key: K, slot: _Slot[V]) -> None:
        with self._lock:
            if self._slots.get(key) is slot:
                del self._slots[key]


class _Slot(Generic[V]):
    value: V

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.filled = False
        self.size = 0
