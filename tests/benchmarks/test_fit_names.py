"""Names' probabilities from what a detector said of objects whose names are known."""

from __future__ import annotations

import pytest

from benchmarks.calibration.fit_names import Named, fitted


def _alike(count: int, group: str, name: str, *, right: bool) -> list[Named]:
    return [Named(group, name, name, 0.7, right)] * count


def test_objects_of_one_set_and_name_weigh_as_the_root_of_their_number() -> None:
    """The nine books of one shelf count as three books of three rooms do."""
    desks = [*_alike(1, "desk-1", "cup", right=False), *_alike(1, "desk-2", "book", right=False)]
    shelf = fitted([*desks, *_alike(9, "shelf-1", "book", right=True)], "detector")
    rooms = [obj for number in range(3) for obj in _alike(1, f"shop-{number}", "book", right=True)]
    apart = fitted([*desks, *rooms], "detector")
    assert (shelf.factor, shelf.offset) == pytest.approx((apart.factor, apart.offset), abs=0.01)
    assert shelf.categories["book"].offset == pytest.approx(apart.categories["book"].offset, abs=0.01)
    assert (shelf.categories["book"].objects, apart.categories["book"].objects) == (10, 4)
