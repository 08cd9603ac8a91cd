"""Work that nobody waits for any more stops: a flag that travels with the call down to the rasterizer."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from fastsplat_contract.errors import CancelledError

_running: ContextVar[Cancellation | None] = ContextVar("_running", default=None)


class Cancellation:
    """The flag of one call; any thread may raise it."""

    def __init__(self) -> None:
        self._event = threading.Event()

    def cancel(self) -> None:
        """Ask the call to stop at its next look."""
        self._event.set()

    @property
    def cancelled(self) -> bool:
        """Whether somebody asked."""
        return self._event.is_set()


@contextmanager
def cancellable(cancellation: Cancellation) -> Iterator[None]:
    """What runs inside, on this thread, looks at this flag."""
    token = _running.set(cancellation)
    try:
        yield
    finally:
        _running.reset(token)


def check_cancelled() -> None:
    """Call this between pieces of long work; cheap.

    Raises:
        CancelledError: the caller went away, or its deadline has passed.
    """
    cancellation = _running.get()
    if cancellation is not None and cancellation.cancelled:
        raise CancelledError("the caller went away, or its deadline has passed")
