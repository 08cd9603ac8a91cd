"""Gate of both protocols: authentication, rate limits and metrics of every call."""

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
