"""Thread pools of the server: bounded, and the only place where blocking work runs.

Both faces share one event loop and these pools, so that the number of calls at work is one number, and an idle
stream (a robot that watches an operation for an hour) costs no thread.
"""

from __future__ import annotations

import asyncio
import contextvars
import os
from collections.abc import AsyncIterator, Callable
from functools import partial
from typing import TypeVar

from fastsplat.api.access.caller import caller_id
from fastsplat.api.fair_pool import FairPool
from fastsplat.api.metrics import Metrics
from fastsplat.api.receiving import Sink, UploadReceiver
from fastsplat.service.common.call_scheduling import CallAgainError, run_by
from fastsplat.service.common.cancellation import Cancellation, cancellable
from fastsplat.service.settings import LimitSettings, UploadSettings

_CALL_DEADLINE_S = 600.0
"""Seconds that any other call may take, waiting included."""

_T = TypeVar("_T")
_R = TypeVar("_R")


class Threads:
    """Bounded pools: one for calls, others for uploads, so that uploads never starve questions."""

    def __init__(
        self,
        limits: LimitSettings | None = None,
        metrics: Metrics | None = None,
        uploads: UploadSettings | None = None,
        validations: int = 1,
    ) -> None:
        """Threads as `limits` say, for uploads as slow as `uploads` say, of which so many are validated at a time;
        `metrics` learns what waits and runs."""
        self._limits = limits or LimitSettings()
        threads = self._limits.threads or max(4, 2 * (os.cpu_count() or 1))
        self._calls = FairPool(threads, "call", self._limits.niceness)
        self._uploads = UploadReceiver(self._limits, uploads or UploadSettings(), max(2, 2 * validations))
        self._metrics = metrics or Metrics()

    async def answer(self, function: Callable[[], _R], background: bool = False) -> _R:
        """As `call`, for a question or a picture, which have less time.

        Args:
            function: the service call.
            background: it renders, so that it runs where it holds up no short call.

        Raises:
            DeadlineExceededError: it was not done in the time that the server gives it.
        """
        return await self.call(function, self._limits.answer_s, background)

    async def call(
        self, function: Callable[[], _R], timeout_s: float = _CALL_DEADLINE_S, background: bool = False
    ) -> _R:
        """Run a service call on a thread and await its answer. If this coroutine is cancelled, so is the call: it stops
        at its next `check_cancelled`; keys take turns.

        Raises:
            DeadlineExceededError: it was not done in the time that the server gives it.
        """
        cancellation = Cancellation(timeout_s)

        def watched() -> _R:
            with cancellable(cancellation), run_by(cancellation):
                cancellation.check()
                return function()

        try:
            while True:
                try:
                    with self._metrics.queued() as call:
                        run = partial(contextvars.copy_context().run, call.run, watched)  # the thread knows who calls
                        call.future = self._calls.submit(caller_id(), run, background=background)
                        return await asyncio.wrap_future(call.future)
                except CallAgainError as again:  # it waits here, without a thread
                    await asyncio.sleep(again.after_s)
        except asyncio.CancelledError:
            cancellation.cancel()
            raise

    async def receive(
        self, stream: AsyncIterator[_T], sink: Sink[_T, _R], size: Callable[[_T], int], memory_bytes: int = 0
    ) -> _R:
        """See `UploadReceiver.receive`."""
        return await self._uploads.receive(stream, sink, size, memory_bytes)

    def close(self) -> None:
        """Wait for what runs, drop what waits."""
        self._uploads.close()
        self._calls.close()
