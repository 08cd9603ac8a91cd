"""Names of other scenes are suggested for what looks like the object that bears them, and for nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike

from fastsplat.service.query.objects.names.names_from_scenes import KnownObject, described, names_by_looks
from fastsplat.service.scene.artefact.scene import Object, Objects
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of

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


def _known(name: str, *parts: tuple[int, float], scene: str = "one") -> KnownObject:
    return KnownObject(scene, name, _looks(*parts))


def test_what_looks_the_same_gets_the_name_and_its_scene() -> None:
    objects = [Object(4, appearance=_looks((0, 1))), Object(7, appearance=_looks((5, 1))), Object(9)]
    names = names_by_looks(objects, [_known("mug", (0, 1)), _known("clock", (9, 1), scene="two")], {})
    assert list(names) == [4]
    assert (names[4].name, names[4].scene_id) == ("mug", "one") and 0.9 < names[4].probability < 0.95


def test_a_known_object_suggests_its_name_for_all_that_are_nearly_as_much_like_it() -> None:
    objects = [Object(n, appearance=_looks((0, 1), (n, share))) for n, share in ((1, 0.1), (2, 0.3), (3, 0.6))]
    names = names_by_looks(objects, [_known("mug", (0, 1))], {})
    assert list(names) == [1, 2] and names[1].probability > names[2].probability
    assert list(names_by_looks(objects[2:], [_known("mug", (0, 1))], {})) == [3]  # where nothing is more like it


def test_a_rival_of_another_name_lowers_the_probability_until_nothing_is_suggested() -> None:
    obj = Object(1, appearance=_looks((0, 1)))

    def rival(share: float) -> KnownObject:
        return _known("bowl", (0, share), (1, np.sqrt(1 - share**2)))

    shares = [0.0, 0.5, 0.8, 0.85]
    suggested = [names_by_looks([obj], [_known("mug", (0, 0.9), (2, 0.436)), rival(share)], {}) for share in shares]
    assert [bool(names) for names in suggested[:2]] == [True, True]
    assert suggested[0][1].probability >= suggested[1][1].probability >= 0.8
    assert names_by_looks([obj], [_known("mug", (0, 0.75), (2, 0.66)), rival(0.74)], {}) == {}
    mug, same = _known("mug", (0, 0.9), (2, 0.436)), _known("Mugs", (0, 0.89), (3, 0.456))
    assert names_by_looks([obj], [mug, same], {}) == names_by_looks([obj], [mug], {})  # the same name is no rival


def test_what_a_person_named_gets_no_suggestion_and_makes_others_less_probable() -> None:
    taken = Object(1, "cup", "person", 1.0, appearance=_looks((0, 1)))
    like_it, less_like_it = (Object(2, appearance=_looks((0, 1), (1, share))) for share in (0.3, 0.6))
    assert list(names_by_looks([taken, like_it], [_known("mug", (0, 1))], {})) == [2]
    assert names_by_looks([taken, less_like_it], [_known("mug", (0, 1))], {}) == {}
    detected = Object(1, "cup", "detected", 0.7, appearance=_looks((0, 1)))
    assert list(names_by_looks([detected, less_like_it], [_known("mug", (0, 1))], {})) == [1]


def test_without_looks_or_with_those_of_another_model_nothing_is_suggested() -> None:
    known = [_known("mug", (0, 1))]
    assert names_by_looks([], known, {}) == names_by_looks([Object(1)], known, {}) == {}
    assert names_by_looks([Object(1, appearance=_looks((0, 1)))], [], {}) == {}
    mug = KnownObject("one", "mug", np.ones(_SIZE // 2, np.float16).tobytes())
    assert names_by_looks([Object(1, appearance=_looks((0, 1)))], [mug], {}) == {}


def test_most_of_a_thousand_objects_that_look_like_nothing_known_stay_without() -> None:
    rng = np.random.default_rng(3)
    objects = [Object(number + 1, appearance=_bytes(row)) for number, row in enumerate(rng.normal(size=(1000, _SIZE)))]
    known = [KnownObject("one", f"object {n}", _bytes(row)) for n, row in enumerate(rng.normal(size=(20, _SIZE)))]
    assert len(names_by_looks(objects, known, {})) <= 5


def _sized(name: str, look: bytes, *sides: float, scene: str = "one") -> KnownObject:
    membership = evidence_of(np.zeros(1, np.int64), np.ones(1, np.int64), np.full(1, UNIT), 1)
    objects = Objects((Object(1, appearance=look), Object(2)), membership)
    known = described(objects, {1: np.array(sides), 2: np.ones(3)})
    assert list(known) == [1]
    return KnownObject(scene, name, known[1])


def test_of_two_that_look_the_same_the_one_of_the_same_size_gives_its_name() -> None:
    look = _looks((0, 1))
    obj, size = Object(1, appearance=look), {1: np.array([0.03, 0.04, 0.05])}
    small, large = _sized("ring", look, 0.003, 0.004, 0.005), _sized("mug", look, 0.031, 0.04, 0.049, scene="two")
    assert names_by_looks([obj], [small, large], size)[1].name == "mug"
    assert names_by_looks([obj], [small, large], {1: size[1] / 10})[1].name == "ring"
    assert names_by_looks([obj], [small, large], {})[1].probability == pytest.approx(0.5)  # by looks alone
    assert names_by_looks([obj], [_known("mug", (0, 1))], size)[1].name == "mug"


def test_the_more_sizes_differ_the_less_probable_a_name_is() -> None:
    obj = Object(1, appearance=_looks((0, 1)))
    known = [_sized("mug", _looks((0, 0.85), (1, 0.527)), 0.1, 0.1, 0.1), _sized("jar", _looks((2, 1)), 0.1, 0.1, 0.1)]
    suggestions = [names_by_looks([obj], known, {1: np.full(3, 0.1 * times)}) for times in (1, 1.2, 1.4, 4)]
    probabilities = [names[1].probability if names else 0.0 for names in suggestions]
    assert probabilities[0] > probabilities[1] > probabilities[2] >= 0.6 and probabilities[-1] == 0
    flat = names_by_looks([obj], [_sized("mug", _looks((0, 1)), 0.0, 0.1, 0.1)], {1: np.array([0.0, 0.1, 0.1])})
    assert flat[1].probability == pytest.approx(0.95)


def test_the_fewer_names_are_known_the_more_an_object_must_look_like_them() -> None:
    known = [_known("mug", (0, 0.7), (1, 0.714)), *(_known(f"name {n}", (n, 1)) for n in range(2, 50))]
    counts = (1, 2, 10, 40)
    assert [len(names_by_looks([Object(1, appearance=_looks((0, 1)))], known[:n], {})) for n in counts] == [0, 0, 0, 1]
