"""Torch's threads and the C heap while the kernels' own threads are at work."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import torch


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Runs the block with one torch thread. Several would make sums depend on their number, and slow torch's small
    loops where other processes compete for the cores; the kernels have threads of their own."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def release_free_memory() -> None:
    """Returns free pages of the C heap to the system, which glibc keeps where arrays grew; does nothing elsewhere."""
    trim = _malloc_trim()
    if trim is not None:
        trim(0)


@cache
def _malloc_trim() -> Any:
    return getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
