"""Cooperative cancellation of calls, checked by long work down to the rasterizer."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from fastsplat_contract.errors import CancelledError, DeadlineExceededError

_running: ContextVar[Cancellation | None] = ContextVar("_running", default=None)


class Cancellation:
    """Cancellation flag and deadline of a call, thread-safe; `timeout_s` counts from now."""

    def __init__(self, timeout_s: float | None = None) -> None:
        self._event = threading.Event()
        self._timeout_s = timeout_s
        self._deadline = None if timeout_s is None else time.monotonic() + timeout_s

    def cancel(self) -> None:
        """Stops the call at its next `check_cancelled`."""
        self._event.set()

    @property
    def cancelled(self) -> bool:
        return self._event.is_set()

    def check(self) -> None:
        """Raises if the call must stop.

        Raises:
            CancelledError: `cancel` was called.
            DeadlineExceededError: the deadline has passed.
        """
        if self.cancelled:
            raise CancelledError("the caller disconnected, or its deadline has passed")
        if self._deadline is not None and time.monotonic() > self._deadline:
            raise DeadlineExceededError(
                "the work takes longer than the server gives it",
                limit=f"{self._timeout_s:g} s",
                hint="Ask for less at once: fewer texts, views or pixels.",
            )


@contextmanager
def cancellable(cancellation: Cancellation) -> Iterator[None]:
    """Makes `check_cancelled` on this thread check this flag."""
    token = _running.set(cancellation)
    try:
        yield
    finally:
        _running.reset(token)


def check_cancelled() -> None:
    """Raises if this thread's call was cancelled; cheap, for use between pieces of work.

    Raises:
        CancelledError: the caller disconnected, or its deadline has passed.
        DeadlineExceededError: the server's own deadline has passed.
    """
    cancellation = _running.get()
    if cancellation is not None:
        cancellation.check()
