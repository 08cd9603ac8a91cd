"""Runs of a text encoder side by side."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray


def embed_side_by_side(
    run: Callable[[str], NDArray[np.float32]], texts: Sequence[str], threads: int
) -> NDArray[np.float32]:
    """float32 [B, E], in the order of the texts: one a run, as many runs at a time as there are threads. Sentences are
    short, so that a second thread inside a run gains nothing.

    Args:
        run: float32 [E] of a text, from any thread.
        texts: one or more.
        threads: runs at a time; 0: all cores.
    """
    side_by_side = min(threads or os.cpu_count() or 1, len(texts))
    if side_by_side == 1:
        return np.stack([run(text) for text in texts])
    # Threads of this call alone: they have the priority of who calls, which kept ones would not.
    with ThreadPoolExecutor(side_by_side, thread_name_prefix="text-encoder") as pool:
        return np.stack(list(pool.map(run, texts)))
