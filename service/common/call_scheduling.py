"""Waiting of calls that cannot go on yet, without a thread where their runner can make them again."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from fastsplat.service.common.cancellation import check_cancelled


class CallAgainError(Exception):
    """A request to repeat the call from its beginning, later; it has changed nothing so far."""

    def __init__(self, after_s: float) -> None:
        super().__init__("the call is to be made again")
        self.after_s = after_s


_runner: ContextVar[object | None] = ContextVar("_runner", default=None)


@contextmanager
def run_by(runner: object) -> Iterator[None]:
    """A context in which `wait_elsewhere`, on this thread, has `runner` make the call again."""
    token = _runner.set(runner)
    try:
        yield
    finally:
        _runner.reset(token)


def current_runner() -> object | None:
    """Who runs the call on this thread, the same object whenever the call is made again; None outside of `run_by`."""
    return _runner.get()


def wait_elsewhere(seconds: float) -> None:
    """Wait without a thread where the call's runner can make it again, otherwise on this one. Only for a call that has
    changed nothing yet.

    Raises:
        CallAgainError: for the runner.
        CancelledError, DeadlineExceededError: as `check_cancelled`.
    """
    check_cancelled()
    if _runner.get() is not None:
        raise CallAgainError(seconds)
    time.sleep(seconds)
