"""Upload receivers on the event loop: a slow sender holds a connection but no thread.

Data are written in batches by short calls on threads. While a batch is written nothing more is read, so that the
transport's flow control slows the sender down and memory stays bounded.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextvars
import logging
import os
import threading
import time
from collections.abc import AsyncIterator, Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, Generic, Protocol, TypeVar

from fastsplat.api.access.caller import caller_id, current_principal
from fastsplat.api.fair_pool import FairPool
from fastsplat.service.common.cancellation import Cancellation, cancellable
from fastsplat.service.settings import LimitSettings, UploadSettings
from fastsplat_contract.errors import DeadlineExceededError, OverloadedError

_T = TypeVar("_T")
_R = TypeVar("_R")
_Item = TypeVar("_Item", contravariant=True)
_Result = TypeVar("_Result", covariant=True)

_log = logging.getLogger(__name__)
_BATCH_BYTES = 1 << 16
_PAUSE_S = 1.0
"""Seconds after which an incomplete batch is written."""
_STALL_S = 60.0
_CLOSE_S = 30.0
_CLOSERS = _FINISHES = 2


class Sink(Protocol[_Item, _Result]):
    """Sink of one upload; its methods run on threads, one at a time."""

    @property
    def slow_finish(self) -> bool:
        """True if `finish` may take long and needs separate threads."""

    def write(self, items: Sequence[_Item]) -> None:
        """Takes the next items."""

    def finish(self) -> _Result:
        """Completes the upload after the last write and returns its result."""

    def close(self) -> None:
        """Ends an upload that `finish` has not completed; must not raise."""


NewSink = Callable[[], Sink[_T, _R]]
"""Makes a sink; see `UploadReceiver.receive`."""


class UploadReceiver:
    """Receiver of all uploads of a process; two are validated at a time, of different projects."""

    def __init__(self, limits: LimitSettings, settings: UploadSettings) -> None:
        self._limits = limits
        self._settings = settings
        self._writers = FairPool(max(4, os.cpu_count() or 1), "upload")
        self._finishers = FairPool(_FINISHES, "finish")
        self._closers = ThreadPoolExecutor(_CLOSERS, thread_name_prefix="close")
        self._changed = threading.Condition()
        self._count = 0
        self._reserved = 0

    async def receive(
        self, stream: AsyncIterator[_T], make: NewSink[_T, _R], size: Callable[[_T], int], memory_bytes: int = 0
    ) -> _R:
        """Writes a stream to a sink, which is closed on failure or cancellation.

        Args:
            make: makes the sink, on a thread; called before anything is read, so that refusals come early.
            size: returns an item's size in bytes.
            memory_bytes: memory that the transport needs for the stream, beyond a batch.

        Raises:
            OverloadedError: the number of uploads or their memory is at its limit.
            DeadlineExceededError: the sender is too slow.
        """
        self._enter(memory_bytes)
        upload = _Upload(self._closers, partial(self._leave, memory_bytes))
        sender = _Sender(stream, size, self._settings)
        key, project = caller_id(), _project()
        try:
            sink = await upload.run(self._writers, key, partial(upload.make_sink, make))
            while items := await sender.batch():
                await upload.run(self._writers, key, partial(sink.write, items))
            # Slow finishes are validations, which take turns by project.
            pool, owner = (self._finishers, project) if sink.slow_finish else (self._writers, key)
            result = await upload.run(pool, owner, sink.finish)
        except asyncio.CancelledError:
            sender.cut()
            upload.cancel()
            raise
        except BaseException:
            await sender.stop()
            await asyncio.shield(asyncio.wrap_future(upload.close()))  # clean up before the error is sent
            raise
        self._leave(memory_bytes)
        return result

    def close(self) -> None:
        """Waits for running uploads to end; their senders must already be disconnected."""
        with self._changed:
            if not self._changed.wait_for(lambda: not self._count, _CLOSE_S):
                _log.error("%d uploads are still under way", self._count)
        self._writers.close()
        self._finishers.close()
        self._closers.shutdown()

    def _enter(self, memory_bytes: int) -> None:
        with self._changed:
            if self._count >= self._limits.all_uploads:
                raise OverloadedError(
                    "as many uploads as the server takes are under way",
                    limit=f"{self._limits.all_uploads} uploads of all keys at a time (FASTSPLAT_LIMITS__ALL_UPLOADS)",
                    hint="Wait a moment, then send it again.",
                )
            if memory_bytes and self._reserved + memory_bytes > self._limits.upload_memory_bytes:
                raise OverloadedError(
                    "the uploads under way hold all the memory that the server has for them",
                    limit=f"{self._limits.upload_memory_bytes} bytes, {memory_bytes} an upload over gRPC "
                    "(FASTSPLAT_LIMITS__UPLOAD_MEMORY_BYTES)",
                    hint="Wait a moment, then send it again, or send it over REST.",
                )
            self._count += 1
            self._reserved += memory_bytes

    def _leave(self, memory_bytes: int) -> None:
        with self._changed:
            self._count -= 1
            self._reserved -= memory_bytes
            self._changed.notify_all()


def _project() -> str:
    principal = current_principal.get()
    return principal.project if principal is not None else ""


class _Upload:
    """Runs one upload's calls on threads, one after the other, the closing one last."""

    def __init__(self, closers: ThreadPoolExecutor, leave: Callable[[], None]) -> None:
        self._close_sink: Callable[[], None] = lambda: None
        self._closers = closers
        self._leave = leave
        self._context = contextvars.copy_context()  # carries the caller's identity
        self._cancellation = Cancellation()
        self._last: concurrent.futures.Future[Any] | None = None

    def make_sink(self, make: Callable[[], Sink[_T, _R]]) -> Sink[_T, _R]:
        """Makes the sink; on the upload's thread, so that it is closed even if nobody waits any more."""
        sink = make()
        self._close_sink = sink.close
        return sink

    async def run(self, pool: FairPool, owner: str, function: Callable[[], _R]) -> _R:
        def watched() -> _R:
            with cancellable(self._cancellation):
                return function()

        future = pool.submit(owner, lambda: self._context.run(watched))
        self._last = future
        return await asyncio.wrap_future(future)

    def cancel(self) -> None:
        self._cancellation.cancel()
        self.close()

    def close(self) -> concurrent.futures.Future[None]:
        """Closes the sink once its last call has ended or was cancelled."""
        closed: concurrent.futures.Future[None] = concurrent.futures.Future()

        def close() -> None:
            try:
                self._context.run(self._close_sink)
            except Exception:
                _log.exception("an upload could not be closed")
            finally:
                self._leave()
                closed.set_result(None)

        if self._last is None:
            self._closers.submit(close)
        else:
            self._last.add_done_callback(lambda _: self._closers.submit(close))
        return closed


class _Sender(Generic[_T]):
    """Reads a sender's stream in batches and enforces its timeouts."""

    def __init__(self, stream: AsyncIterator[_T], size: Callable[[_T], int], settings: UploadSettings) -> None:
        self._stream = stream
        self._size = size
        self._settings = settings
        self._bytes = 0
        self._waited_s = 0.0  # waiting for the sender only, without our own disk's time
        self._next: asyncio.Future[tuple[_T] | None] | None = None

    async def batch(self) -> list[_T]:
        """Reads the next batch, or less if the sender pauses; empty at the end."""
        items: list[_T] = []
        enough = self._bytes + _BATCH_BYTES
        pause_at = 0.0
        while self._bytes < enough:
            began, patience = time.monotonic(), self._patience_s()
            next_item = self._next = self._next or asyncio.ensure_future(self._fetch())
            wait_s = min(patience, pause_at - began) if items else patience
            await asyncio.wait((next_item,), timeout=max(0.0, wait_s))
            self._waited_s += time.monotonic() - began
            if not next_item.done():
                if not items:
                    raise self._too_slow()
                break
            self._next = None
            if (result := next_item.result()) is None:
                break
            if not items:
                pause_at = time.monotonic() + _PAUSE_S
            items.append(result[0])
            self._bytes += self._size(result[0])
        return items

    def cut(self) -> None:
        """Cancels the pending read."""
        if self._next is not None:
            self._next.cancel()
            self._next.add_done_callback(lambda item: item.cancelled() or item.exception())

    async def stop(self) -> None:
        """Cancels the pending read and waits for its end."""
        self.cut()
        if self._next is not None:
            await asyncio.wait((self._next,))

    async def _fetch(self) -> tuple[_T] | None:
        try:
            return (await anext(self._stream),)
        except StopAsyncIteration:
            return None

    def _patience_s(self) -> float:
        """Computes the seconds that the sender may be silent now."""
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
