"""Cost budgets of keys for rendering and encoding: token buckets in units of one rendered pixel."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from fastsplat.service.settings import LimitSettings
from fastsplat_contract.errors import RateLimitedError

_REMEMBERED = 10_000


@dataclass
class _Bucket:
    tokens: float
    at: float


class CostBudgets:
    """Token buckets of all keys of one process. Safe from any thread."""

    def __init__(self, limits: LimitSettings, clock: Callable[[], float] = time.monotonic) -> None:
        self._limits = limits
        self._clock = clock
        self._lock = threading.Lock()
        self._buckets: OrderedDict[str, _Bucket] = OrderedDict()

    def spend(self, key_id: str, cost: float) -> None:
        """Take what a piece of work costs from a key's bucket; what costs more than a full one empties it.

        Args:
            key_id: whose.
            cost: in rendered pixels.

        Raises:
            RateLimitedError: the bucket does not hold that much now; nothing is taken.
        """
        rate, capacity = self._limits.cost_per_s, self._limits.cost_burst
        cost = min(cost, capacity)
        with self._lock:
            now = self._clock()
            bucket = self._buckets.setdefault(key_id, _Bucket(capacity, now))
            self._buckets.move_to_end(key_id)
            bucket.tokens = min(capacity, bucket.tokens + (now - bucket.at) * rate)
            bucket.at = now
            if len(self._buckets) > _REMEMBERED:
                self._buckets.popitem(last=False)
            if bucket.tokens < cost:
                raise RateLimitedError(
                    f"this key has spent what it may on rendering and encoding; this request costs {cost:.0f} pixels",
                    field="authorization",
                    limit=f"{rate:g} pixels a second over time, {capacity} at once",
                    hint="Wait as long as the answer says, or ask for fewer texts, views or pixels.",
                    retry_after_s=(cost - bucket.tokens) / rate,
                )
            bucket.tokens -= cost
