"""Semaphore of upload validations, shared fairly between owners."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from fastsplat.service.common.cancellation import check_cancelled

CONCURRENT_VALIDATIONS = 2
"""Number of concurrent upload validations; more wait."""

_POLL_S = 0.1


class ValidationSlots:
    """Bounded slots; one owner never holds all, unless there is only one slot."""

    def __init__(self, count: int = CONCURRENT_VALIDATIONS) -> None:
        self._count = count
        self._share = max(1, count - 1)
        self._taken: Counter[str] = Counter()
        self._changed = threading.Condition()

    @contextmanager
    def taken(self, owner: str) -> Iterator[None]:
        """Context that holds a slot, waiting for one; raises `CancelledError` while waiting."""
        with self._changed:
            while self._taken.total() >= self._count or self._taken[owner] >= self._share:
                check_cancelled()
                self._changed.wait(_POLL_S)
            self._taken[owner] += 1
        try:
            yield
        finally:
            with self._changed:
                self._taken[owner] -= 1
                if not self._taken[owner]:
                    del self._taken[owner]
                self._changed.notify_all()
