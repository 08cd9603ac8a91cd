"""Texts embedded side by side: each once, in their order, at the priority of who asks."""

from __future__ import annotations

import os
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from fastsplat.service.common.process import lower_priority
from fastsplat.service.perception.text.text_tower import embed_side_by_side


@pytest.mark.parametrize("threads", [0, 1, 2, 7])
@pytest.mark.parametrize("count", [1, 2, 9])
def test_rows_are_in_the_order_of_the_texts_and_each_runs_once(threads: int, count: int) -> None:
    ran: list[str] = []

    def run(text: str) -> np.ndarray:
        ran.append(text)
        return np.array([float(text), 1.0], np.float32)

    texts = [str(number) for number in range(count)]
    rows = embed_side_by_side(run, texts, threads)
    assert rows.dtype == np.float32 and rows[:, 0].tolist() == list(range(count))
    assert sorted(ran) == texts


def test_as_many_run_at_a_time_as_there_are_threads() -> None:
    together = threading.Barrier(3)  # which opens only if three runs wait at once
    embed_side_by_side(lambda text: np.full(1, together.wait(30), np.float32), ["a", "b", "c"], 3)


@pytest.mark.skipif(sys.platform != "linux", reason="threads have a niceness of their own on Linux alone")
def test_runs_have_the_priority_of_the_thread_that_asks() -> None:
    def priority() -> int:
        return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())

    def nicely() -> tuple[int, set[float]]:
        lower_priority(3)
        rows = embed_side_by_side(lambda text: np.full(1, priority(), np.float32), ["a", "b", "c", "d"], 2)
        return priority(), set(rows[:, 0].tolist())

    with ThreadPoolExecutor(1) as pool:
        niceness, of_runs = pool.submit(nicely).result()
    assert niceness > priority() and of_runs == {niceness}
