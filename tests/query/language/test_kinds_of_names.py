"""A proper name is found by what it is: its kinds are asked for where no word of it is known, and kept as aliases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fastsplat.service.perception.lexicon.wordnet import Lexicon
from fastsplat.service.perception.results import TextEncoder
from fastsplat.service.query.edits.apply_edit import apply_edit
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Object, Scene
from fastsplat_contract.errors import InvalidInputError, LimitExceededError
from fastsplat_contract.messages.scenes import Edit
from tests.query.box_scenes import BoxShell, scene_of, with_objects
from tests.query.conftest import DrawnEncoder

_FIRST = BoxShell("x", (0.12, 0.0, 0.06), count=100)
_SECOND = BoxShell("y", (-0.12, 0.0, 0.03), count=100)


@pytest.fixture(scope="module")
def index(lexicon: Lexicon, minilm: TextEncoder) -> SceneIndex:
    """Two objects without names."""
    return SceneIndex(_unnamed(), minilm, QuerySettings(), lexicon=lexicon)


def _unnamed() -> Scene:
    scene = replace(scene_of([_FIRST, _SECOND]), label_embeddings=np.zeros((2, 384), np.float32))
    return with_objects(scene, np.repeat([1, 2], [_FIRST.count, _SECOND.count]), (Object(1), Object(2)))


def named(index: SceneIndex, obj: int, name: str, *kinds: str) -> SceneIndex:
    return index.after(apply_edit(index, Edit("name", object_ids=(obj,), name=name, kinds=kinds)))


def test_a_proper_name_is_found_by_its_kind_and_by_what_that_is_a_kind_of(index: SceneIndex) -> None:
    bare = named(index, 1, "Oskar")
    assert not bare.is_understood("Oskar")
    assert [answer.outcome for answer in bare.ask(["teddy bear", "toy"])] != ["here", "here"]
    with_kind = named(bare, 1, "Oskar", "teddy bear")
    assert with_kind.is_understood("Oskar") and with_kind.scene.dictionary.entries[0].aliases == ("Oskar teddy bear",)
    for answer in with_kind.ask(["Oskar", "teddy bear", "toy"]):
        assert answer.outcome in ("here", "probably_here") and answer.object_ids == (1,), answer.sentence
    assert with_kind.ask(["toy"])[0].relation == "kind_of"
    (stranger,) = with_kind.ask(["bulldozer"])
    assert stranger.outcome != "here"


def test_several_names_are_of_one_kind_and_the_kind_is_still_a_name_of_its_own(index: SceneIndex) -> None:
    both = named(named(index, 1, "Oskar", "teddy bear"), 2, "Bruno", "teddy bear")
    (answer,) = both.ask(["teddy bear"])
    assert set(answer.object_ids) == {1, 2}
    kind_as_name = named(named(index, 1, "Oskar", "teddy bear"), 2, "teddy bear")
    assert {obj.id: obj.name for obj in kind_as_name.objects.listed} == {1: "Oskar", 2: "teddy bear"}
    assert kind_as_name.ask(["teddy bear"])[0].object_ids[0] == 2


@pytest.mark.parametrize(("name", "known"), [("grandma's mug", True), ("mug", True), ("Oskarine", False)])
def test_a_name_is_understood_that_ends_in_a_word(index: SceneIndex, name: str, known: bool) -> None:
    assert named(index, 1, name).is_understood(name) is known


def test_without_a_lexicon_nothing_is_asked() -> None:
    assert SceneIndex(_unnamed(), DrawnEncoder(), QuerySettings(templates=("{}",))).is_understood("Oskar")


def test_kinds_are_names_of_a_name(index: SceneIndex) -> None:
    for edit, error, field in (
        (Edit("unname", object_ids=(1,), kinds=("toy",)), InvalidInputError, "name"),
        (Edit("name", object_ids=(1,), name="Oskar", kinds=("a\nb",)), InvalidInputError, "kinds[0]"),
        (Edit("name", object_ids=(1,), name="Oskar", kinds=("toy",) * 21), LimitExceededError, "kinds"),
        (Edit("name", object_ids=(1,), name="O" * 200, kinds=("toy",)), InvalidInputError, "kinds[0]"),
    ):
        with pytest.raises(error) as raised:
            apply_edit(index, edit)
        assert raised.value.field == field
