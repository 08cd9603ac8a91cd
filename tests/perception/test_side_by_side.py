"""Views that are looked at side by side come in their order, and share the threads."""

from __future__ import annotations

import threading

import pytest

from fastsplat.service.perception.label_maps.side_by_side import in_order, side_by_side
from fastsplat.service.perception.perception_settings import PerceptionSettings


@pytest.mark.parametrize(("threads", "views", "of_each"), [(1, 1, 1), (2, 2, 1), (3, 2, 1), (16, 2, 8)])
def test_threads_are_shared(threads: int, views: int, of_each: int) -> None:
    at_once, settings = side_by_side(PerceptionSettings(threads=threads))
    assert (at_once, settings.threads) == (views, of_each)


def test_every_core_is_used_where_nobody_says_how_many(monkeypatch: pytest.MonkeyPatch) -> None:
    for cores, expected in ((8, (2, 4)), (None, (1, 1))):
        monkeypatch.setattr("os.cpu_count", lambda cores=cores: cores)
        at_once, settings = side_by_side(PerceptionSettings())
        assert (at_once, settings.threads) == expected


def test_results_keep_the_order_and_few_are_begun_before_they_are_taken() -> None:
    begun: list[int] = []
    later = threading.Event()

    def work(item: int) -> int:
        begun.append(item)
        if item % 2:
            later.set()
        else:
            assert later.wait(60)  # the second of two is there before the first: both are at work
            later.clear()
        return -item

    results = in_order(work, range(6), 2)
    for taken in range(6):
        assert next(results) == -taken
        assert len(begun) <= 2 * (taken // 2 + 1)
    assert sorted(begun) == list(range(6)) and next(results, None) is None


def test_an_error_is_the_callers() -> None:
    def work(item: int) -> int:
        raise ValueError(f"no {item}")

    with pytest.raises(ValueError, match="no 0"):
        list(in_order(work, [0, 1], 2))
    assert list(in_order(work, [], 2)) == []
