"""The server's bounded thread pools, shared by both protocols; all blocking work runs here.

Idle streams, such as a robot watching an operation for an hour, hold no thread.
"""

from __future__ import annotations

import asyncio
import contextvars
import os
from collections.abc import AsyncIterator, Awaitable, Callable
from functools import partial
from typing import TypeVar

from fastsplat.api.access.caller import caller_id
from fastsplat.api.fair_pool import FairPool
from fastsplat.api.metrics import Call, Metrics
from fastsplat.api.receiving import NewSink, UploadReceiver
from fastsplat.service.common.call_scheduling import CallAgainError, run_by
from fastsplat.service.common.cancellation import Cancellation, cancellable
from fastsplat.service.settings import LimitSettings, UploadSettings

_CALL_DEADLINE_S = 600.0
"""Deadline of calls other than questions and pictures, waiting included."""

_T = TypeVar("_T")
_R = TypeVar("_R")


class Threads:
    """Bounded pools for calls and, separately, for uploads, which cannot starve calls."""

    def __init__(
        self,
        limits: LimitSettings | None = None,
        metrics: Metrics | None = None,
        uploads: UploadSettings | None = None,
    ) -> None:
        self._limits = limits or LimitSettings()
        threads = self._limits.threads or max(4, 2 * (os.cpu_count() or 1))
        self._calls = FairPool(threads, "call", self._limits.niceness)
        self._uploads = UploadReceiver(self._limits, uploads or UploadSettings())
        self._metrics = metrics or Metrics()

    def answer(self, function: Callable[[], _R], background: bool = False) -> Awaitable[_R]:
        """Runs a question or a picture as `call` does, with the shorter deadline `answer_s`."""
        return self.call(function, self._limits.answer_s, background)

    async def call(
        self, function: Callable[[], _R], timeout_s: float = _CALL_DEADLINE_S, background: bool = False
    ) -> _R:
        """Runs a service call on a thread, at low priority if `background`; keys take turns.

        Cancelling this coroutine cancels the call, which stops at its next `check_cancelled`.

        Raises:
            DeadlineExceededError: the deadline has passed.
        """
        cancellation = Cancellation(timeout_s)

        def watched(call: Call) -> _R:
            with call.running(), cancellable(cancellation), run_by(cancellation):
                cancellation.check()
                return function()

        try:
            while True:
                try:
                    with self._metrics.queued() as call:
                        run = partial(contextvars.copy_context().run, watched, call)  # with the caller's identity
                        call.future = self._calls.submit(caller_id(), run, background=background)
                        return await asyncio.wrap_future(call.future)
                except CallAgainError as again:  # waits without holding a thread
                    await asyncio.sleep(again.after_s)
        except asyncio.CancelledError:
            cancellation.cancel()
            raise

    async def receive(
        self, stream: AsyncIterator[_T], make: NewSink[_T, _R], size: Callable[[_T], int], memory_bytes: int = 0
    ) -> _R:
        return await self._uploads.receive(stream, make, size, memory_bytes)

    def close(self) -> None:
        """Waits for running calls and drops waiting ones."""
        self._uploads.close()
        self._calls.close()
