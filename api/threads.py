"""Where blocking work runs: never on the event loop, and never on more threads than this.

Both faces share one event loop and these two pools, so that the number of calls at work is one number, and an idle
stream (a robot that watches an operation for an hour) costs no thread.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextvars
import os
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from fastsplat.api.access.caller import caller_id
from fastsplat.api.access.cost_budgets import CostBudgets
from fastsplat.api.fair_pool import FairPool
from fastsplat.api.metrics import Metrics
from fastsplat.service.common.call_scheduling import CallAgainError, run_by
from fastsplat.service.common.cancellation import Cancellation, cancellable
from fastsplat.service.settings import LimitSettings, UploadSettings
from fastsplat_contract.errors import CancelledError, DeadlineExceededError, OverloadedError

_T = TypeVar("_T")
_R = TypeVar("_R")

_STALL_S = 60.0


class Threads:
    """Two bounded pools: one for calls, one for uploads, so that slow uploads never starve questions."""

    def __init__(
        self,
        limits: LimitSettings | None = None,
        metrics: Metrics | None = None,
        uploads: UploadSettings | None = None,
    ) -> None:
        """Threads as `limits` say, for uploads as slow as `uploads` say; `metrics` learns what waits and runs."""
        self._limits = limits or LimitSettings()
        self._upload_settings = uploads or UploadSettings()
        threads = self._limits.threads or max(4, 2 * (os.cpu_count() or 1))
        self._calls = FairPool(threads, "call", self._limits.costly_niceness)
        self._budgets = CostBudgets(self._limits)
        self._uploads = ThreadPoolExecutor(self._limits.all_uploads, thread_name_prefix="upload")
        self._receiving = 0
        self._metrics = metrics or Metrics()

    async def answer(self, function: Callable[[], _R]) -> _R:
        """As `call`, for a question or a picture, which have less time.

        Raises:
            DeadlineExceededError: it was not done in the time that the server gives it.
        """
        return await self._run(function, self._limits.answer_s)

    async def call(self, function: Callable[[], _R]) -> _R:
        """Run a service call on a thread and await its answer. If this coroutine is cancelled, so is the call: it stops
        at its next `check_cancelled`; keys take turns.

        Raises:
            DeadlineExceededError: it was not done in the time that the server gives it.
        """
        return await self._run(function, self._limits.call_s)

    async def _run(self, function: Callable[[], _R], timeout_s: float) -> _R:
        cancellation = Cancellation(timeout_s)
        account = _Account(self._budgets, caller_id(), self._limits.costly)

        def watched() -> _R:
            account.begin()
            with cancellable(cancellation), run_by(account):
                cancellation.check()
                return function()

        try:
            while True:
                try:
                    return await self._run_once(watched, costly=account.costly)
                except CallAgainError as again:  # it waits here, without a thread
                    account.costly = account.costly or again.costly
                    await asyncio.sleep(again.after_s)
        except asyncio.CancelledError:
            cancellation.cancel()
            raise

    async def _run_once(self, function: Callable[[], _R], *, costly: bool) -> _R:
        with self._metrics.queued() as call:
            context = contextvars.copy_context()  # the thread knows who calls
            call.future = self._calls.submit(caller_id(), lambda: context.run(call.run, function), costly=costly)
            return await asyncio.wrap_future(call.future)

    async def consume(
        self, stream: AsyncIterator[_T], function: Callable[[Iterator[_T]], _R], size: Callable[[_T], int]
    ) -> _R:
        """Run `function` on a thread over `stream` as a plain iterator.

        Items are fetched one by one as the thread asks for them, so a slow disk slows the sender down through the
        transport's own flow control and nothing piles up in memory. If the sender goes away, or this coroutine is
        cancelled, the thread's next fetch or `check_cancelled` raises.

        Args:
            stream: what the sender sends.
            function: what takes it.
            size: bytes of an item.

        Raises:
            OverloadedError: as many uploads as the server takes are under way.
            DeadlineExceededError: the sender is too slow.
        """
        if self._receiving >= self._limits.all_uploads:
            raise OverloadedError(
                "as many uploads as the server takes are under way",
                limit=f"{self._limits.all_uploads} uploads of all keys at a time (FASTSPLAT_LIMITS__ALL_UPLOADS)",
                hint="Wait a moment, then send it again.",
            )
        feed = _Feed(asyncio.get_running_loop(), stream, size, self._upload_settings)
        context = contextvars.copy_context()  # the thread knows who calls
        cancellation = Cancellation()

        def received() -> _R:
            with cancellable(cancellation):
                return function(feed)

        self._receiving += 1
        future = asyncio.get_running_loop().run_in_executor(self._uploads, lambda: context.run(received))
        future.add_done_callback(self._received)
        try:
            return await asyncio.shield(future)
        except asyncio.CancelledError:
            cancellation.cancel()
            feed.cut()
            future.add_done_callback(_silence)
            raise

    def _received(self, future: asyncio.Future[Any]) -> None:
        self._receiving -= 1

    def close(self) -> None:
        """Wait for what runs, drop what waits."""
        self._calls.close()
        self._uploads.shutdown(cancel_futures=True)


class _Account:
    """What one call costs, however often it is made.

    Args:
        budgets: of all keys.
        key_id: who calls.
        limit: pixels from which on the call belongs to the costly ones.
    """

    def __init__(self, budgets: CostBudgets, key_id: str, limit: int) -> None:
        self._budgets = budgets
        self._key_id = key_id
        self._limit = limit
        self._cost = 0.0  # this time
        self._paid = 0.0
        self.costly = False

    def begin(self) -> None:
        """The call is made, or made again."""
        self._cost = 0.0

    def charge(self, cost: float) -> None:
        """See `CallRunner.charge`."""
        self._cost += cost
        if self._cost > self._paid:
            self._budgets.spend(self._key_id, self._cost - self._paid)
            self._paid = self._cost
        if self._cost > self._limit and not self.costly:
            raise CallAgainError(costly=True)


class _Feed(Iterator[_T]):
    """An asynchronous stream as an iterator for another thread."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        stream: AsyncIterator[_T],
        size: Callable[[_T], int],
        settings: UploadSettings,
    ) -> None:
        self._loop = loop
        self._stream = stream
        self._size = size
        self._settings = settings
        self._bytes = 0
        self._waited_s = 0.0  # for the sender; what our own disk takes is not its fault
        self._gone = threading.Event()
        self._pending: concurrent.futures.Future[tuple[_T] | None] | None = None

    def cut(self) -> None:
        """The sender is gone: the thread's fetch, this one or the next, raises."""
        self._gone.set()
        if self._pending is not None:
            self._pending.cancel()

    def __next__(self) -> _T:
        began = time.monotonic()
        self._pending = asyncio.run_coroutine_threadsafe(self._fetch(), self._loop)
        try:
            item = self._pending.result(max(0.0, self._patience_s()))
        except concurrent.futures.CancelledError:
            raise CancelledError("the sender went away") from None
        except TimeoutError:
            self._pending.cancel()
            raise self._too_slow() from None
        self._waited_s += time.monotonic() - began
        # An end that comes with a cancellation is no end: what has arrived must not pass for the whole.
        if self._gone.is_set():
            raise CancelledError("the sender went away")
        if item is None:
            raise StopIteration
        self._bytes += self._size(item[0])
        return item[0]

    def _patience_s(self) -> float:
        """How long the sender may now be silent."""
        settings = self._settings
        behind = settings.slow_start_s + self._bytes / settings.min_bytes_per_s - self._waited_s
        return min(behind, _STALL_S, settings.deadline_s - self._waited_s)

    def _too_slow(self) -> DeadlineExceededError:
        settings = self._settings
        return DeadlineExceededError(
            f"the upload is too slow: {self._bytes} bytes so far",
            limit=f"{settings.min_bytes_per_s:g} bytes a second, {_STALL_S:g} s between two chunks, "
            f"{settings.deadline_s:g} s in all",
            hint="Send it again over a better connection, or in pieces (tus, /v1/uploads).",
        )

    async def _fetch(self) -> tuple[_T] | None:
        if self._gone.is_set():
            raise CancelledError("the sender went away")
        try:
            return (await anext(self._stream),)
        except StopAsyncIteration:
            return None


def _silence(future: asyncio.Future[_R]) -> None:
    if not future.cancelled():
        future.exception()
