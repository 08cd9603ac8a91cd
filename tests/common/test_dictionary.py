"""Laws of the hash table of labels."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.service.common.dictionary import Dictionary, DictionaryEntry, dictionary_of, label_key
from fastsplat_contract.errors import InvalidInputError


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("Coffee-Machines", "coffee machine"),
        ("COFFEE_MACHINE", "coffee  machine "),
        ("knives", "knife"),
        ("boxes", "box"),
        ("dishes", "dish"),
        ("cherries", "cherry"),
        ("glasses", "GLASSES"),
        ("running shoes", "running shoe"),
        ("tomatoes", "tomato"),
        ("cookies", "cookie"),
        ("vases", "vase"),
        ("ﬁsh tank", "fish tank"),
        ("Straße", "STRASSE"),
    ],
)
def test_variants_share_a_key(one: str, other: str) -> None:
    assert label_key(one) == label_key(other)


@pytest.mark.parametrize(
    ("one", "other"), [("bus", "bu"), ("glass", "glas"), ("lens", "len"), ("猫", "犬"), ("😀", "😁")]
)
def test_different_things_keep_different_keys(one: str, other: str) -> None:
    assert label_key(one) != label_key(other)


@given(st.text(min_size=1))
def test_a_key_is_its_own_key(name: str) -> None:
    assert label_key(label_key(name)) == label_key(name)


@given(st.lists(st.text(st.characters(categories=["L", "N"]), min_size=1), max_size=20))
def test_every_name_is_found_under_its_own_id(names: list[str]) -> None:
    dictionary = dictionary_of(names)
    for name in names:
        label_id = dictionary.id_of(name)
        assert label_id is not None
        assert label_key(dictionary.label_of(label_id)) == label_key(name)


def test_two_entries_cannot_share_a_name() -> None:
    with pytest.raises(InvalidInputError, match="share a name"):
        Dictionary((DictionaryEntry("mug"), DictionaryEntry("cup", aliases=("Mugs",))))
