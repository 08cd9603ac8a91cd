"""Which object the demonstration names by a click."""

from __future__ import annotations

import numpy as np

from fastsplat.cli.demo.main_job import object_to_name
from fastsplat_contract.messages.objects import SceneObject


def _object(object_id: int, name: str = "", kind: str = "object") -> SceneObject:
    source = "detected" if name else None
    return SceneObject(object_id, name, source, 0.0, (), kind, "", 1.0, 10, None, False)


def test_the_largest_object_without_a_name_before_named_ones_and_surfaces() -> None:
    ids = np.repeat(np.array([0, 1, 2, 3, 4], np.uint16), [50, 40, 30, 20, 10]).reshape(10, 15)
    ids = np.pad(ids, 1)
    floor, cup = _object(1, kind="surface"), _object(2, "cup")
    assert object_to_name(ids, {1: floor, 2: cup, 3: _object(3), 4: _object(4)}) == 3
    assert object_to_name(ids, {1: floor, 2: cup, 3: _object(3, "bowl"), 4: _object(4, "fork")}) == 2
    assert object_to_name(ids[:, :0], {}) is None


def test_what_the_picture_shows_whole_before_what_it_cuts_off() -> None:
    ids = np.ones((10, 10), np.uint16)
    ids[3:6, 3:6] = 2
    assert object_to_name(ids, {1: _object(1), 2: _object(2)}) == 2
    assert object_to_name(ids, {1: _object(1), 2: _object(2, "cup")}) == 1
