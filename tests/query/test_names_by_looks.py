"""Names of other scenes are suggested for what looks like the thing that bears them, and for nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike

from fastsplat.service.query.things.names_by_looks import KnownThing, names_by_looks
from fastsplat.service.scene.types import Thing

_SIZE = 64


def _looks(*parts: tuple[int, float]) -> bytes:
    """A descriptor of length 1 with these numbers at these places."""
    row = np.zeros(_SIZE)
    for place, number in parts:
        row[place] = number
    return _bytes(row)


def _bytes(row: ArrayLike) -> bytes:
    numbers = np.asarray(row, np.float64)
    return (numbers / np.linalg.norm(numbers)).astype(np.float16).tobytes()


def _known(name: str, *parts: tuple[int, float], scene: str = "one") -> KnownThing:
    return KnownThing(scene, name, _looks(*parts))


def test_what_looks_the_same_gets_the_name_and_its_scene() -> None:
    things = [Thing(4, appearance=_looks((0, 1))), Thing(7, appearance=_looks((5, 1))), Thing(9)]
    names = names_by_looks(things, [_known("mug", (0, 1)), _known("clock", (9, 1), scene="two")])
    assert list(names) == [4]
    assert (names[4].name, names[4].scene_id, names[4].probability) == ("mug", "one", pytest.approx(0.95))


def test_a_known_thing_suggests_its_name_once_for_the_one_that_is_most_like_it() -> None:
    things = [Thing(1, appearance=_looks((0, 1), (1, 0.1))), Thing(2, appearance=_looks((0, 1), (1, 0.3)))]
    assert list(names_by_looks(things, [_known("mug", (0, 1))])) == [1]
    both = [_known("mug", (0, 1)), _known("mug", (0, 1), (1, 0.4))]
    assert list(names_by_looks(things, both)) == [1, 2]


def test_a_rival_of_another_name_lowers_the_probability_until_nothing_is_suggested() -> None:
    thing = Thing(1, appearance=_looks((0, 1)))

    def rival(share: float) -> KnownThing:
        return _known("bowl", (0, share), (1, np.sqrt(1 - share**2)))

    shares = [0.0, 0.5, 0.8, 0.99]
    suggested = [names_by_looks([thing], [_known("mug", (0, 0.9), (2, 0.436)), rival(share)]) for share in shares]
    assert [bool(names) for names in suggested[:2]] == [True, True]
    assert suggested[0][1].probability >= suggested[1][1].probability >= 0.8
    assert names_by_looks([thing], [_known("mug", (0, 0.75), (2, 0.66)), rival(0.74)]) == {}
    same = _known("Mugs", (0, 0.89), (3, 0.456))  # the same name is no rival
    assert names_by_looks([thing], [_known("mug", (0, 0.9), (2, 0.436)), same])[1] == suggested[0][1]


def test_what_a_person_named_gets_no_suggestion_and_leaves_none_to_others() -> None:
    taken = Thing(1, "cup", "person", 1.0, appearance=_looks((0, 1)))
    like_it = Thing(2, appearance=_looks((0, 1), (1, 0.3)))
    assert names_by_looks([taken, like_it], [_known("mug", (0, 1))]) == {}
    detected = Thing(1, "cup", "detected", 0.7, appearance=_looks((0, 1)))
    assert list(names_by_looks([detected, like_it], [_known("mug", (0, 1))])) == [1]


def test_without_looks_or_with_those_of_another_model_nothing_is_suggested() -> None:
    known = [_known("mug", (0, 1))]
    assert names_by_looks([], known) == names_by_looks([Thing(1)], known) == {}
    assert names_by_looks([Thing(1, appearance=_looks((0, 1)))], []) == {}
    other = KnownThing("one", "mug", np.ones(_SIZE // 2, np.float16).tobytes())
    assert names_by_looks([Thing(1, appearance=_looks((0, 1)))], [other]) == {}


def test_most_of_a_thousand_things_that_look_like_nothing_known_stay_without() -> None:
    rng = np.random.default_rng(3)
    things = [Thing(number + 1, appearance=_bytes(row)) for number, row in enumerate(rng.normal(size=(1000, _SIZE)))]
    known = [KnownThing("one", f"thing {n}", _bytes(row)) for n, row in enumerate(rng.normal(size=(20, _SIZE)))]
    assert len(names_by_looks(things, known)) <= 5
