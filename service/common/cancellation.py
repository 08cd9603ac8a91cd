"""Cancellation of calls that nobody waits for any more, by a flag that long work checks, down to the rasterizer."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from fastsplat_contract.errors import CancelledError, DeadlineExceededError

_running: ContextVar[Cancellation | None] = ContextVar("_running", default=None)


class Cancellation:
    """The cancellation flag of one call, and its deadline; any thread may set it.

    Args:
        timeout_s: seconds from now that the call may take; None for no bound.
    """

    def __init__(self, timeout_s: float | None = None) -> None:
        self._event = threading.Event()
        self._timeout_s = timeout_s
        self._deadline = None if timeout_s is None else time.monotonic() + timeout_s

    def cancel(self) -> None:
        """Stop the call at its next `check_cancelled`."""
        self._event.set()

    @property
    def cancelled(self) -> bool:
        """Whether `cancel` was called."""
        return self._event.is_set()

    def check(self) -> None:
        """Raise if the call is not to go on.

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
    """A context in which `check_cancelled`, on this thread, checks this flag."""
    token = _running.set(cancellation)
    try:
        yield
    finally:
        _running.reset(token)


def check_cancelled() -> None:
    """Raise if the call that runs here was cancelled; to be called between pieces of long work, at little cost.

    Raises:
        CancelledError: the caller disconnected, or its deadline has passed.
        DeadlineExceededError: the server's own deadline has passed.
    """
    cancellation = _running.get()
    if cancellation is not None:
        cancellation.check()
