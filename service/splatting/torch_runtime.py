"""Controls torch's threads and the C heap beside the multithreaded kernels."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Runs the block with one torch thread.

    Sums then do not depend on the thread count, and small loops stay fast when other processes compete for cores.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def release_free_memory() -> None:
    """Returns free C heap pages to the system, which glibc otherwise keeps."""
    if trim := getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None:
        trim(0)
