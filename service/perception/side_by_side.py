"""Views looked at side by side: networks of their size gain little by a second thread."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from fastsplat.service.perception.settings import PerceptionSettings

_AT_ONCE = 2
"""A network on two threads waits for itself a third of the time, and each view at once takes 0.4 GB."""

T = TypeVar("T")
R = TypeVar("R")


def side_by_side(settings: PerceptionSettings) -> tuple[int, PerceptionSettings]:
    """How many views are looked at at once, and the settings with which: they share the threads."""
    threads = settings.threads or os.cpu_count() or 1
    views = min(_AT_ONCE, threads)
    return views, settings.model_copy(update={"threads": threads // views})


def in_order(work: Callable[[T], R], items: Sequence[T], at_once: int) -> Iterator[R]:
    """What `work` makes of each item, in their order; of `at_once` items at the same time, the next of them once what
    is made of these is taken."""
    with ThreadPoolExecutor(at_once) as pool:
        for begin in range(0, len(items), at_once):
            yield from pool.map(work, items[begin : begin + at_once])
