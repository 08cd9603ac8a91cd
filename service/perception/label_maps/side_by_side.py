"""Parallel processing of views, as networks of this size gain little by more threads."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from fastsplat.service.perception.perception_settings import PerceptionSettings

_AT_ONCE = 2  # a network on two threads waits for itself a third of the time; a view takes 0.4 GB

T = TypeVar("T")
R = TypeVar("R")


def side_by_side(settings: PerceptionSettings) -> tuple[int, PerceptionSettings]:
    """Number of views to process at once, and settings that divide the threads among them."""
    threads = settings.threads or os.cpu_count() or 1
    views = min(_AT_ONCE, threads)
    return views, settings.model_copy(update={"threads": threads // views})


def in_order(work: Callable[[T], R], items: Sequence[T], at_once: int) -> Iterator[R]:
    """Maps items in order, `at_once` at a time; the next start once results are taken."""
    with ThreadPoolExecutor(at_once) as pool:
        for begin in range(0, len(items), at_once):
            yield from pool.map(work, items[begin : begin + at_once])
