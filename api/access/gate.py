"""Gate of both protocols: authentication, rate limits and metrics of every call."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from fastsplat.api.access.authenticator import Authenticator, Credentials, KeyWatch
from fastsplat.api.access.caller import Principal
from fastsplat.api.metrics import Metrics
from fastsplat.service.application.admin.admin import Admin
from fastsplat.service.application.admin.keys import KeyRing
from fastsplat.service.settings import LimitSettings, Settings
from fastsplat_contract.call import Rule
from fastsplat_contract.errors import FastSplatError, OverloadedError, RateLimitedError

_REMEMBERED = 10_000


@dataclass
class _Account:
    tokens: float
    at: float
    in_flight: int = 0
    uploads: int = 0


class RateLimiter:
    """Rate limits of one process: a token bucket per key, and limits of concurrent calls.

    Excess calls are refused at once. A limit over all keys bounds the thread pool's queue. Event loop only.
    """

    def __init__(self, settings: LimitSettings, clock: Callable[[], float] = time.monotonic) -> None:
        self._settings = settings
        self._clock = clock
        self._accounts: OrderedDict[str, _Account] = OrderedDict()
        self.admitted = 0
        """Calls in flight that are not long-lived."""

    def enter(self, principal: Principal, rule: Rule) -> _Permit:
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
        return _Permit(self, account, rule)

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


class _Permit:
    """Admission of one call; `leave` must be called once."""

    def __init__(self, limiter: RateLimiter, account: _Account, rule: Rule) -> None:
        self._limiter, self._account, self._rule = limiter, account, rule

    def leave(self) -> None:
        self._account.in_flight -= 1
        self._account.uploads -= self._rule.upload
        self._limiter.admitted -= not self._rule.long_lived


@dataclass(frozen=True)
class Gate:
    """Authentication and limits of calls, shared so that a key's limits span both protocols."""

    authenticator: Authenticator
    limiter: RateLimiter
    metrics: Metrics
    auth_enabled: bool

    @contextmanager
    def refusals_counted(self) -> Iterator[None]:
        """Counts errors that the block raises as refusals."""
        try:
            yield
        except FastSplatError as error:
            self.metrics.refused(error.reason)
            raise

    async def authenticate(self, credentials: Credentials, rule: Rule) -> Principal | None:
        with self.refusals_counted():
            return await self.authenticator.authenticate(credentials, rule)

    @contextmanager
    def entered(self, principal: Principal, rule: Rule) -> Iterator[KeyWatch]:
        """Counts a call as in flight; the block ends if its key becomes invalid.

        Raises:
            RateLimitedError, OverloadedError: as `RateLimiter.enter`.
            UnauthenticatedError: as `Authenticator.watch`.
        """
        with self.refusals_counted():
            permit = self.limiter.enter(principal, rule)
        try:
            with self.authenticator.watch(principal) as watch:
                yield watch
        finally:
            permit.leave()


def build_gate(settings: Settings, admin: Admin | None, metrics: Metrics | None = None) -> Gate:
    """Builds the gate; without an `admin` there are no valid keys."""
    on = settings.auth == "on"
    load = admin.keys.valid if admin is not None else lambda: KeyRing({})
    return Gate(Authenticator(load, on), RateLimiter(settings.limits), metrics or Metrics(), on)
