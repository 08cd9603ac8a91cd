"""Scheduling hints of calls: what their work will cost, and that they cannot go on yet.

Costs are in units of one rendered pixel, known from a request's arguments before the work is done.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Protocol

from fastsplat.service.common.cancellation import check_cancelled

SENTENCE_COST = 2**14
"""Encoding a sentence takes about as long as rendering so many pixels."""


class CallAgainError(Exception):
    """A request to repeat the call from its beginning, later or on another thread; it has changed nothing so far."""

    def __init__(self, after_s: float = 0.0, *, costly: bool = False) -> None:
        super().__init__("the call is to be made again")
        self.after_s = after_s
        self.costly = costly


class CallRunner(Protocol):
    """Interface of whatever runs calls."""

    def charge(self, cost: float) -> None:
        """Say what the work that is about to be done will cost.

        Raises:
            CallAgainError: the call is too costly for the thread that it runs on.
        """


_runner: ContextVar[CallRunner | None] = ContextVar("_runner", default=None)


@contextmanager
def run_by(runner: CallRunner) -> Iterator[None]:
    """A context in which `charge` and `wait_elsewhere`, on this thread, turn to `runner`."""
    token = _runner.set(runner)
    try:
        yield
    finally:
        _runner.reset(token)


def current_runner() -> CallRunner | None:
    """Who runs the call on this thread, the same object whenever the call is made again; None outside of `run_by`."""
    return _runner.get()


def charge(cost: float) -> None:
    """Say what the work that is about to be done will cost; nothing where nobody asks.

    Args:
        cost: in rendered pixels.

    Raises:
        CallAgainError: as `CallRunner.charge`.
    """
    runner = _runner.get()
    if runner is not None:
        runner.charge(cost)


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
