"""A small store of costly values: each made once, the least recently used leave first."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class LeastRecentlyUsed(Generic[K, V]):
    """At most `size` values. Threads that want the same missing value wait for one of them to make it."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._lock = threading.Lock()
        self._slots: OrderedDict[K, _Slot[V]] = OrderedDict()

    def get(self, key: K, make: Callable[[], V]) -> V:
        """The value of `key`, made now if it is not here. A failure to make it is not kept."""
        with self._lock:
            slot = self._slots.setdefault(key, _Slot())
            self._slots.move_to_end(key)
            while len(self._slots) > self._size:
                self._slots.popitem(last=False)
        with slot.lock:
            if not slot.filled:
                try:
                    slot.value = make()
                except BaseException:
                    self._drop(key, slot)
                    raise
                slot.filled = True
            return slot.value

    def drop(self, unwanted: Callable[[K], bool]) -> None:
        """Let go of every key that `unwanted` names; whoever holds a value keeps it."""
        with self._lock:
            for key in [key for key in self._slots if unwanted(key)]:
                del self._slots[key]

    def __len__(self) -> int:
        with self._lock:
            return len(self._slots)

    def _drop(self, key: K, slot: _Slot[V]) -> None:
        with self._lock:
            if self._slots.get(key) is slot:
                del self._slots[key]


class _Slot(Generic[V]):
    value: V

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.filled = False
