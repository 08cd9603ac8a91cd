"""Keys to callers."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from fastsplat.api.access.caller import Principal
from fastsplat.api.access.policy import Rule
from fastsplat.service.application.keys import KeyRing, key_id_of
from fastsplat_contract.errors import PermissionDeniedError, UnauthenticatedError

_HOW = 'Send it as "Authorization: Bearer KEY"; make one with: fastsplat keys create'


class Authenticator:
    """Turns keys into callers, from a copy of the valid keys in memory that is never older than `FRESH_S` seconds.

    Args:
        load: reads the valid keys from the database, on a thread; None: keys are switched off.
    """

    FRESH_S = 2.0
    _GLANCE_S = 0.2  # for a key that is not known yet: it may be new, and who guesses costs one look in this time

    def __init__(self, load: Callable[[], KeyRing] | None) -> None:
        self._load = load
        self._ring = KeyRing({})
        self._loaded_at = float("-inf")
        self._loading: asyncio.Task[None] | None = None

    async def authenticate(self, key: str, rule: Rule) -> Principal | None:
        """Who calls, if they may; None for an open route, whatever key came with it.

        Args:
            key: as the caller sent it; "" for none.
            rule: that of the matched route.

        Raises:
            UnauthenticatedError: no key, or none that is valid.
            PermissionDeniedError: a key that reads, where one that writes is needed.
            DatabaseError: the keys cannot be read.
        """
        if rule.need == "open":
            return None
        if self._load is None:
            return Principal("")
        if not key:
            raise UnauthenticatedError("this call carries no key", field="authorization", hint=_HOW)
        key_id = key_id_of(key)
        if self._age() > self.FRESH_S or (key_id and key_id not in self._ring and self._age() > self._GLANCE_S):
            await self._refresh()
        record = self._ring.find(key)
        if record is None:
            raise UnauthenticatedError("the key is unknown, expired or revoked", field="authorization", hint=_HOW)
        if rule.need == "write" and record.kind != "write":
            raise PermissionDeniedError(
                f"key {record.id} may only read", field="authorization", hint="Use a key of the kind write."
            )
        return Principal(record.id)

    def _age(self) -> float:
        return time.monotonic() - self._loaded_at

    async def _refresh(self) -> None:
        if self._loading is None:
            self._loading = asyncio.create_task(self._reload())
            self._loading.add_done_callback(self._loaded)
        await asyncio.shield(self._loading)  # a caller that goes away must not fail the others

    async def _reload(self) -> None:
        assert self._load is not None
        begun = time.monotonic()  # a key revoked while this reads may still be in what it brings
        self._ring = await asyncio.to_thread(self._load)
        self._loaded_at = begun

    def _loaded(self, task: asyncio.Task[None]) -> None:
        self._loading = None
        if not task.cancelled():
            task.exception()  # those who wait have seen it


def extract_api_key(authorization: str, x_api_key: str) -> str:
    """The key in either header, "" for none."""
    scheme, _, value = authorization.partition(" ")
    return value.strip() if scheme.lower() == "bearer" else x_api_key.strip()
