"""Maps that an open scene keeps never weigh more than is said of them."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from fastsplat.service.query.objects.object_index import KEPT_MAP_BYTES, KeptMaps, ObjectMap


def _drawn(side: int) -> ObjectMap:
    return np.empty((side, side), np.uint16)  # pages that nobody touches


@pytest.mark.parametrize("sides", [[256] * 600, [1024] * 40, [4096, 4096], [5000], [256, 4096, 256, 3000, 256, 1]])
def test_kept_maps_are_bounded_by_their_bytes(sides: list[int]) -> None:
    maps = KeptMaps()
    drawn: list[int] = []

    def draw(side: int) -> np.ndarray:
        drawn.append(side)
        return _drawn(side)

    for number, side in enumerate(sides):
        assert maps.get(number, partial(draw, side)).shape == (side, side)
        assert 0 <= maps.nbytes <= KEPT_MAP_BYTES
    assert drawn == sides
    last = len(sides) - 1
    maps.get(last, partial(draw, sides[last]))
    assert len(drawn) - len(sides) == (2 * sides[last] ** 2 > KEPT_MAP_BYTES)


def test_the_map_that_was_used_longest_ago_leaves_first() -> None:
    maps = KeptMaps()
    entries = [maps.get(number, lambda: _drawn(2048)) for number in range(4)]  # as many as there is room for
    assert maps.get(0, lambda: _drawn(1)) is entries[0]
    maps.get(4, lambda: _drawn(2048))
    assert maps.get(0, lambda: _drawn(1)) is entries[0]
    assert maps.get(1, lambda: _drawn(1)) is not entries[1]
