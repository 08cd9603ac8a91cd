"""Rate limits (token bucket per key) and limits of concurrent calls.

Excess calls are refused at once. A limit over all keys bounds the thread pool's queue. Event loop only.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from fastsplat.api.access.caller import Principal
from fastsplat.service.settings import LimitSettings
from fastsplat_contract.call import Rule
from fastsplat_contract.errors import OverloadedError, RateLimitedError

_REMEMBERED = 10_000


@dataclass
class _Account:
    tokens: float
    at: float
    in_flight: int = 0
    uploads: int = 0


class RateLimiter:
    """Rate limits of all keys of one process."""

    def __init__(self, settings: LimitSettings, clock: Callable[[], float] = time.monotonic) -> None:
        self._settings = settings
        self._clock = clock
        self._accounts: OrderedDict[str, _Account] = OrderedDict()
        self.admitted = 0
        """Calls in flight that are not long-lived."""

    def enter(self, principal: Principal, rule: Rule) -> Permit:
        """Admits a call, which counts as in flight until its permit leaves.

        Raises:
            RateLimitedError: the key calls too often or has too many calls in flight.
            OverloadedError: the limit over all keys is reached.
        """
        limits = self._settings
        account = self._account(principal.key_id)
        if account.in_flight >= limits.in_flight:
            raise RateLimitedError(
                f"{account.in_flight} calls of this key are under way",
                limit=f"{limits.in_flight} calls at a time (FASTSPLAT_LIMITS__IN_FLIGHT)",
                hint="Wait for answers before asking more.",
            )
        if rule.upload and account.uploads >= limits.uploads:
            raise RateLimitedError(
                f"{account.uploads} uploads of this key are under way",
                limit=f"{limits.uploads} uploads at a time (FASTSPLAT_LIMITS__UPLOADS)",
                hint="Send one file after the other.",
            )
        if account.tokens < 1:
            raise RateLimitedError(
                "this key calls too often",
                limit=f"{limits.rate_per_s:g} calls a second (FASTSPLAT_LIMITS__RATE_PER_S)",
                hint="Wait as long as the answer says, then send it again.",
                retry_after_s=(1 - account.tokens) / limits.rate_per_s,
            )
        if not rule.long_lived and self.admitted >= limits.admitted:
            raise OverloadedError(
                "the server has all the work it can answer in good time",
                limit=f"{limits.admitted} calls of all keys at a time (FASTSPLAT_LIMITS__ADMITTED)",
                hint="Wait a moment, then send it again.",
            )
        account.tokens -= 1
        account.in_flight += 1
        account.uploads += rule.upload
        self.admitted += not rule.long_lived
        return Permit(self, account, rule)

    def _account(self, key_id: str) -> _Account:
        now = self._clock()
        account = self._accounts.setdefault(key_id, _Account(self._settings.burst, now))
        self._accounts.move_to_end(key_id)
        account.tokens = min(self._settings.burst, account.tokens + (now - account.at) * self._settings.rate_per_s)
        account.at = now
        if len(self._accounts) > _REMEMBERED:
            oldest = next(iter(self._accounts))
            if not self._accounts[oldest].in_flight:
                del self._accounts[oldest]
        return account


class Permit:
    """Admission of one call; `leave` must be called once."""

    def __init__(self, limiter: RateLimiter, account: _Account, rule: Rule) -> None:
        self._limiter, self._account, self._rule = limiter, account, rule

    def leave(self) -> None:
        self._account.in_flight -= 1
        self._account.uploads -= self._rule.upload
        self._limiter.admitted -= not self._rule.long_lived
