"""Which thing the demonstration names by a click."""

from __future__ import annotations

import numpy as np

from fastsplat.cli.demo.main_job import thing_to_name
from fastsplat_contract.messages.things import SceneThing


def _thing(thing_id: int, name: str = "", kind: str = "thing") -> SceneThing:
    source = "detected" if name else None
    return SceneThing(thing_id, name, source, 0.0, (), kind, "", 1.0, 10, None, False)


def test_the_largest_thing_without_a_name_before_named_ones_and_surfaces() -> None:
    ids = np.repeat(np.array([0, 1, 2, 3, 4], np.uint16), [50, 40, 30, 20, 10]).reshape(10, 15)
    ids = np.pad(ids, 1)
    floor, cup = _thing(1, kind="surface"), _thing(2, "cup")
    assert thing_to_name(ids, {1: floor, 2: cup, 3: _thing(3), 4: _thing(4)}) == 3
    assert thing_to_name(ids, {1: floor, 2: cup, 3: _thing(3, "bowl"), 4: _thing(4, "fork")}) == 2
    assert thing_to_name(ids[:, :0], {}) is None


def test_what_the_picture_shows_whole_before_what_it_cuts_off() -> None:
    ids = np.ones((10, 10), np.uint16)
    ids[3:6, 3:6] = 2
    assert thing_to_name(ids, {1: _thing(1), 2: _thing(2)}) == 2
    assert thing_to_name(ids, {1: _thing(1), 2: _thing(2, "cup")}) == 1
