"""Names of other scenes are suggested for what bears the tag of the object that was named, and for nothing else."""

from __future__ import annotations

import pytest

from fastsplat.service.query.objects.names.names_from_scenes import KnownObject, names_by_tags
from fastsplat.service.scene.artefact.scene import Object
from fastsplat_contract.messages.object_reads import ObjectRead


def _object(number: int, *tags: str) -> Object:
    return Object(number, reads=tuple(ObjectRead("tag", tag, 0.9, 3) for tag in tags))


def _known(name: str, *tags: str, scene: str = "one") -> KnownObject:
    return KnownObject(scene, name, b"", tags=tuple((tag, 0.8) for tag in tags))


def test_what_bears_the_tag_gets_the_name_as_likely_as_both_were_read() -> None:
    names = names_by_tags([_object(4, "17"), _object(7, "18"), _object(9)], [_known("toolbox", "17")])
    assert list(names) == [4]
    assert (names[4].name, names[4].scene_id, names[4].source) == ("toolbox", "one", "tag")
    assert names[4].probability == pytest.approx(0.97 * 0.9 * 0.8)


def test_a_number_that_is_printed_as_text_is_no_tag() -> None:
    read = Object(4, reads=(ObjectRead("text", "17", 0.9, 3),))
    assert names_by_tags([read], [_known("toolbox", "17")]) == {}


def test_what_several_objects_bear_or_one_scene_calls_differently_tells_nothing() -> None:
    assert names_by_tags([_object(4, "17"), _object(7, "17")], [_known("toolbox", "17")]) == {}
    known = [_known("toolbox", "17"), _known("drill", "17")]
    assert names_by_tags([_object(4, "17")], known) == {}
    assert list(names_by_tags([_object(4, "17")], [known[0], _known("Toolboxes", "17")])) == [4]


def test_of_several_scenes_the_name_that_was_given_last_counts() -> None:
    known = [_known("drill", "17", scene="new"), _known("toolbox", "17", scene="old")]
    assert names_by_tags([_object(4, "17")], known)[4].name == "drill"


def test_what_a_person_named_keeps_its_name_and_another_tag_may_tell_more() -> None:
    named = Object(4, "chest", "person", 1.0, reads=_object(4, "17").reads)
    assert names_by_tags([named], [_known("toolbox", "17")]) == {}
    known = [_known("toolbox", "17"), KnownObject("one", "drill", b"", tags=(("18", 0.99),))]
    assert names_by_tags([_object(4, "17", "18")], known)[4].name == "drill"
