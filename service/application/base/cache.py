"""LRU cache whose bytes count in the memory budget."""

from __future__ import annotations

from typing import TypeVar

from fastsplat.service.application.base.memory import MemoryBudget
from fastsplat.service.common.cache import K, LeastRecentlyUsed

V = TypeVar("V")


class BudgetedCache(LeastRecentlyUsed[K, V]):
    """LRU cache of up to `budget` bytes, until a call needs their room. Thread-safe."""

    def __init__(self, budget: int, memory: MemoryBudget) -> None:
        super().__init__(budget)
        self._memory = memory
        self._counted = False

    def count(self) -> None:
        """Counts the budget as held from now on, unless the cache is empty; drops all values without room."""
        with self._lock:
            uncounted = not self._counted and bool(self._slots)
            self._counted |= uncounted
        if uncounted and not self._memory.keep(self.budget, self.release):
            self.release()

    def release(self) -> None:
        """Drops all values; their users keep them."""
        with self._lock:
            self._counted = False
        self.drop(lambda key: True)
