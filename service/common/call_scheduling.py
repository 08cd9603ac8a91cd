"""Lets calls wait without occupying a thread if their runner can repeat them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from fastsplat.service.common.cancellation import check_cancelled


class CallAgainError(Exception):
    """Asks the runner to repeat the call later; nothing has been changed yet."""

    def __init__(self, after_s: float) -> None:
        super().__init__("the call is to be made again")
        self.after_s = after_s


_runner: ContextVar[object | None] = ContextVar("_runner", default=None)


@contextmanager
def run_by(runner: object) -> Iterator[None]:
    """Sets the `runner` that repeats calls of `wait_elsewhere` on this thread."""
    token = _runner.set(runner)
    try:
        yield
    finally:
        _runner.reset(token)


def current_runner() -> object | None:
    """Returns the runner of this thread's call, identical on each repetition, or None."""
    return _runner.get()


def wait_elsewhere(seconds: float) -> None:
    """Waits by having the runner repeat the call, otherwise by sleeping.

    Only for calls that have changed nothing yet.

    Raises:
        CallAgainError: for the runner.
        CancelledError, DeadlineExceededError: as `check_cancelled`.
    """
    check_cancelled()
    if _runner.get() is not None:
        raise CallAgainError(seconds)
    time.sleep(seconds)
