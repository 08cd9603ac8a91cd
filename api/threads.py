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
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from fastsplat.api.metrics import Metrics
from fastsplat.service.common.cancellation import Cancellation, cancellable
from fastsplat_contract.errors import CancelledError, InvalidInputError

_T = TypeVar("_T")
_R = TypeVar("_R")

_STALL_S = 60.0


class Threads:
    """Two bounded pools: one for calls, one for uploads, so that slow uploads never starve questions."""

    def __init__(self, size: int = 0, metrics: Metrics | None = None) -> None:
        """Threads for calls: `size`, or if 0 two a core and at least four. `metrics` learns what waits and runs."""
        self._calls = ThreadPoolExecutor(size or max(4, 2 * (os.cpu_count() or 1)), thread_name_prefix="call")
        self._uploads = ThreadPoolExecutor(8, thread_name_prefix="upload")
        self._metrics = metrics or Metrics()

    async def call(self, function: Callable[[], _R]) -> _R:
        """Run a service call on a thread and await its answer. If this coroutine is cancelled, so is the call: it stops
        at its next `check_cancelled`."""
        cancellation = Cancellation()

        def watched() -> _R:
            with cancellable(cancellation):
                return function()

        try:
            with self._metrics.queued() as call:
                call.future = self._calls.submit(call.run, watched)
                return await asyncio.wrap_future(call.future)
        except asyncio.CancelledError:
            cancellation.cancel()
            raise

    async def consume(self, stream: AsyncIterator[_T], function: Callable[[Iterator[_T]], _R]) -> _R:
        """Run `function` on a thread over `stream` as a plain iterator.

        Items are fetched one by one as the thread asks for them, so a slow disk slows the sender down through the
        transport's own flow control and nothing piles up in memory. If the sender goes away, or this coroutine is
        cancelled, the thread's next fetch raises.
        """
        loop = asyncio.get_running_loop()
        feed = _Feed(loop, stream)
        context = contextvars.copy_context()  # the thread knows who calls
        future = loop.run_in_executor(self._uploads, lambda: context.run(function, feed))
        try:
            return await asyncio.shield(future)
        except asyncio.CancelledError:
            feed.cut()
            future.add_done_callback(_silence)
            raise

    def close(self) -> None:
        """Wait for what runs, drop what waits."""
        self._calls.shutdown(cancel_futures=True)
        self._uploads.shutdown(cancel_futures=True)


class _Feed(Iterator[_T]):
    """An asynchronous stream as an iterator for another thread."""

    def __init__(self, loop: asyncio.AbstractEventLoop, stream: AsyncIterator[_T]) -> None:
        self._loop = loop
        self._stream = stream
        self._gone = threading.Event()
        self._pending: concurrent.futures.Future[tuple[_T] | None] | None = None

    def cut(self) -> None:
        """The sender is gone: the thread's fetch, this one or the next, raises."""
        self._gone.set()
        if self._pending is not None:
            self._pending.cancel()

    def __next__(self) -> _T:
        self._pending = asyncio.run_coroutine_threadsafe(self._fetch(), self._loop)
        try:
            item = self._pending.result(_STALL_S)
        except concurrent.futures.CancelledError:
            raise CancelledError("the sender went away") from None
        except TimeoutError:
            self._pending.cancel()
            raise InvalidInputError(
                f"the upload stalled for {_STALL_S:g} s",
                limit=f"{_STALL_S:g} s between two chunks",
                hint="Send it again.",
            ) from None
        # An end that comes with a cancellation is no end: what has arrived must not pass for the whole.
        if self._gone.is_set():
            raise CancelledError("the sender went away")
        if item is None:
            raise StopIteration
        return item[0]

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
