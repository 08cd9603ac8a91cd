"""Values that a cache keeps never weigh more than it may hold, and those used longest ago leave first."""

from __future__ import annotations

from functools import partial

import pytest

from fastsplat.service.common.cache import LeastRecentlyUsed


@pytest.mark.parametrize("sizes", [[1] * 600, [16] * 40, [64, 64], [1, 64, 1, 47, 1, 0]])
def test_values_are_bounded_by_their_size(sizes: list[int]) -> None:
    cache: LeastRecentlyUsed[int, object] = LeastRecentlyUsed(64)
    made_of: list[int] = []

    def make(number: int) -> object:
        made_of.append(number)
        return object()

    for number, size in enumerate(sizes):
        value = cache.get(number, partial(int, size), partial(make, number))
        assert 0 <= cache.bytes <= 64
        assert cache.get(number, partial(int, size), partial(make, number)) is value
    assert made_of == list(range(len(sizes)))


def test_the_value_that_was_used_longest_ago_leaves_first() -> None:
    cache: LeastRecentlyUsed[int, object] = LeastRecentlyUsed(4)
    values = [cache.get(number, lambda: 1, object) for number in range(4)]  # as many as there is room for
    assert cache.get(0, lambda: 1, object) is values[0]
    cache.get(4, lambda: 1, object)
    assert cache.get(0, lambda: 1, object) is values[0]
    assert cache.get(1, lambda: 1, object) is not values[1]
