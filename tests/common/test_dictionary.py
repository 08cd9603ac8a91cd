"""Laws of the hash table of labels."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.service.common.dictionary import Dictionary, DictionaryEntry, dictionary_of, label_key
from fastsplat.service.perception.class_names import COCO_80, TAGS
from fastsplat_contract.errors import InvalidInputError

HOUSEHOLD = """mug, cup, wine glass, plate, bowl, spoon, fork, knife, coffee machine, kettle, teapot, toaster, oven,
stove, fridge, sink, tap, dish, box, vase, shelf, bookshelf, loaf, leaf, scarf, glove, shoe, brush, toothbrush, bench,
couch, torch, watch, match, peach, radish, cherry, strawberry, battery, cookie, hoodie, pie, tie, smoothie,
potato, tomato, mango, piano, radio, photo, bus, lens, gas cylinder, canvas, mattress, dress, cutting board, ice
cube tray, key, toy, monkey, mouse, goose, child, man, woman, person, foot, tooth, die, menu, taxi, cactus,
octopus, compass, iris, atlas, virus, thermos, axe, house, horse, nurse, hose, rose, olive, sleeve, orange,
sausage, sponge, bridge, cabbage""".replace("\n", " ").split(", ")
ONE_FORM = tuple("scissors, red scissors, glasses, reading glasses, sunglasses, jeans, clothes, sheep".split(", "))
IRREGULAR_PLURALS = {"die": "dies", "thermos": "thermoses", "cactus": "cacti"}


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("Coffee-Machines", "coffee machine"), ("COFFEE_MACHINE", "coffee  machine "), ("glasses", "GLASSES"),
        ("running shoes", "running shoe"), ("the dies", "the die"), ("dice", "die"), ("chess pieces", "chess piece"),
        ("ﬁsh tank", "fish tank"), ("Straße", "STRASSE"),
    ],
)  # fmt: skip
def test_variants_share_a_key(first: str, second: str) -> None:
    assert label_key(first) == label_key(second)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("bus", "bu"), ("glass", "glas"), ("glass", "glasses"), ("lens", "len"), ("clothes", "clothe"),
        ("clothes", "cloth"), ("dies", "dy"), ("tennis", "tenni"), ("猫", "犬"), ("😀", "😁"),
    ],
)  # fmt: skip
def test_different_objects_keep_different_keys(first: str, second: str) -> None:
    assert label_key(first) != label_key(second)


@given(st.text(min_size=1) | st.text(st.sampled_from("aeioumnsxyvfz"), min_size=1, max_size=12))
def test_a_key_is_its_own_key(name: str) -> None:
    assert label_key(label_key(name)) == label_key(name)


@given(st.lists(st.text(st.characters(categories=["L", "N"]), min_size=1), max_size=20))
def test_every_name_is_found_under_its_own_id(names: list[str]) -> None:
    dictionary = dictionary_of(names)
    for name in names:
        label_id = dictionary.id_of(name)
        assert label_id is not None
        assert label_key(dictionary.label_of(label_id)) == label_key(name)


@pytest.mark.parametrize("name", ONE_FORM)
def test_what_has_no_other_number_stays(name: str) -> None:
    assert label_key(name) == name


@pytest.mark.parametrize("name", HOUSEHOLD)
@given(st.sampled_from(["", "red ", "Two-", "the_other "]))
def test_the_key_of_a_plural_is_the_key_of_its_singular(name: str, before: str) -> None:
    import inflect  # not by each process that collects tests: it takes seconds

    plural = IRREGULAR_PLURALS.get(name) or inflect.engine().plural_noun(name)
    assert label_key(before + plural) == label_key(before + name) != ""
    assert label_key(plural) == name


def test_no_list_has_a_name_twice() -> None:
    for labels in (COCO_80, TAGS):
        assert len(dictionary_of(labels)) == len(labels)


def test_names_that_later_rules_take_for_one_still_answer_for_themselves() -> None:
    """A scene is not rewritten when the rules for plurals change: "dice" and "die" were two names once."""
    dictionary = Dictionary((DictionaryEntry("dice"), DictionaryEntry("die"), DictionaryEntry("mug", ("Dies",))))
    assert label_key("dice") == label_key("die") == label_key("dies")
    assert [dictionary.id_of(name) for name in ("dice", "DIE", "dies", "mugs")] == [1, 2, 3, 3]


def test_two_entries_cannot_share_a_name() -> None:
    with pytest.raises(InvalidInputError, match="share a name"):
        Dictionary((DictionaryEntry("mug"), DictionaryEntry("cup", aliases=("MUG ",))))


@pytest.mark.parametrize("confidence", [-0.1, 1.1, float("nan")])
def test_a_confidence_is_a_share(confidence: float) -> None:
    with pytest.raises(InvalidInputError, match="confidence"):
        Dictionary((DictionaryEntry("mug", confidence=confidence),))
