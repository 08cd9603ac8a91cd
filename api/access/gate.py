"""What decides on every call of both protocols, and counts it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from fastsplat.api.access.authenticator import Authenticator
from fastsplat.api.access.caller import Principal
from fastsplat.api.access.policy import Rule
from fastsplat.api.access.rate_limits import Permit, RateLimiter
from fastsplat.api.metrics import Metrics
from fastsplat.service.application.admin import Admin
from fastsplat.service.application.keys import KeyRing
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import FastSplatError


@dataclass(frozen=True)
class Gate:
    """The same for both protocols, so that a key's limits are one.

    Attributes:
        authenticator: knows the keys.
        limiter: knows who has how many calls under way.
        metrics: counts.
        auth_enabled: False only by an explicit setting.
    """

    authenticator: Authenticator
    limiter: RateLimiter
    metrics: Metrics
    auth_enabled: bool

    @contextmanager
    def refusals_counted(self) -> Iterator[None]:
        """Count what the block raises."""
        try:
            yield
        except FastSplatError as error:
            self.metrics.refused(error.reason)
            raise

    async def authenticate(self, key: str, rule: Rule) -> Principal | None:
        """See `Authenticator.authenticate`."""
        with self.refusals_counted():
            return await self.authenticator.authenticate(key, rule)

    def enter(self, principal: Principal, rule: Rule) -> Permit:
        """See `RateLimiter.enter`."""
        with self.refusals_counted():
            return self.limiter.enter(principal, rule)


def build_gate(settings: Settings, admin: Admin | None, metrics: Metrics | None = None) -> Gate:
    """The gate as `settings` ask for it; without an `admin` there are no keys, and with keys on nobody gets in."""
    on = settings.auth == "on"
    load = admin.keys.valid if admin is not None else lambda: KeyRing({})
    return Gate(Authenticator(load if on else None), RateLimiter(settings.limits), metrics or Metrics(), on)
