"""Waiting for a condition, and for limits that a machine of any speed can keep."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

_T = TypeVar("_T")


def wait_for(what: Callable[[], object], patience_s: float = 120.0) -> None:
    """Return once `what()` is true; fail the test if it never is."""
    deadline = time.monotonic() + patience_s
    while not what():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.02)


def with_growing_limit(attempt: Callable[[float], _T | None], first_s: float, most_s: float = 120.0) -> _T:
    """Returns `attempt(limit)`, tripling the limit (s) while that is None; fails if `most_s` did not suffice."""
    limit_s = first_s
    while limit_s <= most_s:
        result = attempt(limit_s)
        if result is not None:
            return result
        limit_s *= 3.0
    raise AssertionError(f"{most_s:g} seconds were not enough")
