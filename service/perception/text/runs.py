"""Runs of a text encoder side by side."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray


class TextRuns:
    """One text a run, as many runs at a time as there are threads: sentences are short, so that a second thread inside
    a run gains nothing. Threads may share it.

    Args:
        run: float32 [E] of a text.
        threads: runs at a time; 0: all cores.
    """

    def __init__(self, run: Callable[[str], NDArray[np.float32]], threads: int) -> None:
        self._run = run
        self._pool = ThreadPoolExecutor(threads or os.cpu_count() or 1, thread_name_prefix="text-encoder")

    def embed(self, texts: Sequence[str]) -> NDArray[np.float32]:
        """float32 [B, E], in the order of the texts."""
        if len(texts) == 1:
            return self._run(texts[0])[None]
        return np.stack(list(self._pool.map(self._run, texts)))
