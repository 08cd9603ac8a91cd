"""Cancellation of calls that nobody waits for any more, by a flag that long work checks, down to the rasterizer."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from fastsplat_contract.errors import CancelledError

_running: ContextVar[Cancellation | None] = ContextVar("_running", default=None)


class Cancellation:
    """The cancellation flag of one call; any thread may set it."""

    def __init__(self) -> None:
        self._event = threading.Event()

    def cancel(self) -> None:
        """Stop the call at its next `check_cancelled`."""
        self._event.set()

    @property
    def cancelled(self) -> bool:
        """Whether `cancel` was called."""
        return self._event.is_set()


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
    """
    cancellation = _running.get()
    if cancellation is not None and cancellation.cancelled:
        raise CancelledError("the caller disconnected, or its deadline has passed")
