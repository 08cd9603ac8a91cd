"""What decides on every call of both faces, and counts it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from fastsplat.api.auth import Doorkeeper, Principal, Rule
from fastsplat.api.limits import Entry, Limiter
from fastsplat.api.metrics import Metrics
from fastsplat.service.application.admin import Admin
from fastsplat.service.application.keys import KeyRing
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import FastSplatError


@dataclass(frozen=True)
class Doors:
    """The same for both faces, so that a key's limits are one.

    Attributes:
        keeper: knows the keys.
        limiter: knows who has how many calls under way.
        metrics: counts.
        keys_are_on: False only by an explicit setting.
    """

    keeper: Doorkeeper
    limiter: Limiter
    metrics: Metrics
    keys_are_on: bool

    @contextmanager
    def refusals_counted(self) -> Iterator[None]:
        """Count what the block raises."""
        try:
            yield
        except FastSplatError as error:
            self.metrics.refused(error.reason)
            raise

    async def admit(self, key: str, rule: Rule) -> Principal | None:
        """See `Doorkeeper.admit`."""
        with self.refusals_counted():
            return await self.keeper.admit(key, rule)

    def enter(self, principal: Principal, rule: Rule) -> Entry:
        """See `Limiter.enter`."""
        with self.refusals_counted():
            return self.limiter.enter(principal, rule)


def open_doors(settings: Settings, admin: Admin | None, metrics: Metrics | None = None) -> Doors:
    """The doors as `settings` want them; without an `admin` there are no keys, and with keys on nobody gets in."""
    on = settings.auth == "on"
    load = admin.keys.valid if admin is not None else lambda: KeyRing({})
    return Doors(Doorkeeper(load if on else None), Limiter(settings.limits), metrics or Metrics(), on)
