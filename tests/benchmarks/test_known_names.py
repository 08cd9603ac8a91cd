"""Names: suggestions in a room are counted by what its objects are, and probabilities fitted to what objects were."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.calibration.fit_appearance import directions_of
from benchmarks.known_names.__main__ import FoundRoom, count_suggestions, examples, one_kind_each, summed
from fastsplat.service.jobs.detector_calibration import NamedObject, fit_name_model
from fastsplat.service.scene.artefact.scene import Object, Objects
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of

_SIZE = 16


def _room(name: str, *looks: tuple[int, str]) -> FoundRoom:
    """Objects that look like these places and are of these kinds, "" for what is no true object."""
    table = tuple(
        Object(n, appearance=np.eye(_SIZE, dtype=np.float16)[place].tobytes())
        for n, (place, _) in enumerate(looks, start=1)
    )
    rows = np.arange(len(looks))
    objects = Objects(table, evidence_of(rows, rows + 1, np.full(len(looks), UNIT), len(looks)))
    sizes = {obj.id: np.full(3, 0.1) for obj in table}
    return FoundRoom(name, objects, sizes, {n: kind for n, (_, kind) in enumerate(looks, start=1) if kind})


def test_right_wrong_and_missed_names_are_told_apart() -> None:
    known = examples(_room("one", (0, "mug"), (1, "book"), (2, "lamp"), (9, "")))
    assert [example.name for example in known] == ["mug", "book", "lamp"]
    room = _room("two", (0, "mug"), (1, "box"), (5, "lamp"), (2, ""), (6, "vase"))
    counts = count_suggestions(room, known)
    assert (counts["nameable"], counts["suggested"], counts["right"]) == (2, 3, 1)
    assert (counts["suggested_80"], counts["right_80"]) == (3, 1)
    undescribed = replace(room.objects, table=tuple(replace(obj, appearance=b"") for obj in room.objects.table))
    assert set(count_suggestions(room._replace(objects=undescribed), known).values()) == {0}


def test_one_kind_at_a_time_has_at_most_three_examples() -> None:
    known = examples(_room("one", *((n, "mug") for n in range(5)), (7, "book")))
    assert [[example.name for example in by_kind] for by_kind in one_kind_each(known)] == [["book"], ["mug"] * 3]
    assert summed([{"right": 1, "nameable": 2}, {"right": 3, "nameable": 4}]) == {"right": 4, "nameable": 6}


def test_directions_follow_what_differs_between_kinds_though_it_differs_more_within_them() -> None:
    kinds, between = ["mug", "book"] * 80, np.outer([-1, 1] * 80, np.eye(6)[0])
    features = np.random.default_rng(0).normal(size=(160, 6)) * (0.1, 2, 2, 1, 1, 1) + between
    assert np.abs(directions_of(features, kinds, 1)).argmax() == 0 and features.var(axis=0).argmax() != 0


def _alike(count: int, group: str, name: str, *, right: bool) -> list[NamedObject]:
    return [NamedObject(group, name, name, 0.7, right)] * count


def test_objects_of_one_set_and_name_weigh_as_the_root_of_their_number() -> None:
    """The nine books of one shelf count as three books of three rooms do."""
    desks = [*_alike(1, "desk-1", "cup", right=False), *_alike(1, "desk-2", "book", right=False)]
    shelf = fit_name_model([*desks, *_alike(9, "shelf-1", "book", right=True)], "detector")
    rooms = [obj for number in range(3) for obj in _alike(1, f"shop-{number}", "book", right=True)]
    apart = fit_name_model([*desks, *rooms], "detector")
    assert (shelf.factor, shelf.offset) == pytest.approx((apart.factor, apart.offset), abs=0.01)
    assert shelf.categories["book"].offset == pytest.approx(apart.categories["book"].offset, abs=0.01)
    assert (shelf.categories["book"].objects, apart.categories["book"].objects) == (10, 4)
