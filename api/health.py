"""Readiness check, shared by both protocols."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable

from fastsplat_contract.errors import FastSplatError, NotReadyNowError

_log = logging.getLogger(__name__)
_DEADLINE_S = 5.0


class Readiness:
    """Cached result of a periodic check that raises a FastSplatError if something is missing."""

    PERIOD_S = 1.0

    def __init__(self, check: Callable[[], None]) -> None:
        self._check = check
        self._missing: str | None = "the first check has not ended"
        self._draining = False
        self._looking: asyncio.Task[None] | None = None

    def require(self) -> None:
        """Raises `NotReadyNowError` unless the server is ready."""
        why = "the server is about to stop" if self._draining else self._missing
        if why is not None:
            raise NotReadyNowError(f"not ready: {why}", hint="Ask again in a moment.")

    @property
    def ready(self) -> bool:
        return self._missing is None and not self._draining

    def drain(self) -> None:
        self._draining = True

    async def look(self) -> None:
        """Runs the check once, for at most 5 s."""
        before = self._missing
        if self._looking is None:  # a hanging check is not started twice
            self._looking = asyncio.create_task(asyncio.to_thread(self._check))
        ended, _ = await asyncio.wait({self._looking}, timeout=_DEADLINE_S)
        try:
            if ended:
                looked, self._looking = self._looking, None
                looked.result()
                self._missing = None
            else:
                self._missing = f"the checks have not ended for {_DEADLINE_S:g} s"
        except FastSplatError as error:
            self._missing = error.message
        except Exception:
            _log.exception("the readiness check failed unexpectedly")
            self._missing = "the check failed unexpectedly"
        if self._missing != before:
            _log.info("ready" if self._missing is None else "not ready", extra={"why": self._missing or ""})

    async def watch(self, changed: Callable[[bool], Awaitable[None]]) -> None:
        """Runs the check periodically and reports each change of readiness to `changed`."""
        last_ready: bool | None = None
        while True:
            await self.look()
            if self.ready != last_ready:
                last_ready = self.ready
                await changed(self.ready)
            await asyncio.sleep(self.PERIOD_S)
