"""The gate of both protocols: authentication, policy and rate limits of every call, and its count in the metrics."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from fastsplat.api.access.authenticator import Authenticator, Credentials, KeyWatch
from fastsplat.api.access.caller import Principal
from fastsplat.api.access.rate_limits import RateLimiter
from fastsplat.api.metrics import Metrics
from fastsplat.service.application.admin.admin import Admin
from fastsplat.service.application.admin.keys import KeyRing
from fastsplat.service.settings import Settings
from fastsplat_contract.call import Rule
from fastsplat_contract.errors import FastSplatError


@dataclass(frozen=True)
class Gate:
    """Authentication and limits of a call; one for both protocols, so that a key's limits are one.

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

    async def authenticate(self, credentials: Credentials, rule: Rule) -> Principal | None:
        """See `Authenticator.authenticate`."""
        with self.refusals_counted():
            return await self.authenticator.authenticate(credentials, rule)

    @contextmanager
    def entered(self, principal: Principal, rule: Rule) -> Iterator[KeyWatch]:
        """Count a call as under way while the block runs, and end the block soon after its key is no longer valid.

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
    """The gate as `settings` ask for it; without an `admin` there are no keys, and with keys on nobody gets in."""
    on = settings.auth == "on"
    load = admin.keys.valid if admin is not None else lambda: KeyRing({})
    return Gate(Authenticator(load, on), RateLimiter(settings.limits), metrics or Metrics(), on)
