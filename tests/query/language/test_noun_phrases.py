"""The grammar of questions: what is asked for, and what is said of it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.service.query.language.words.noun_phrases import (
    noun_groups,
    noun_phrase,
    parse_noun_phrase,
    split_modifiers,
)


@pytest.mark.parametrize(
    ("text", "phrase"),
    [
        ("the mug", "mug"), ("a coffee machine", "coffee machine"), ("Where is the mug?", "mug"),
        ("where's my mug", "mug"), ("WHERE ARE THE SPOONS?!", "SPOONS"),
        ("please find me the coffee machine", "coffee machine"), ("is there a mug here?", "mug"),
        ("Is the mug in this room?", "mug"), ("show me all of the mugs, please", "mugs"), ('"mug"', "mug"),
        ("  mug \n", "mug"), ("the", "the"), ("where is", "where is"), ("?!", "?!"), ("where is the", "the"),
        ("theatre", "theatre"), ("find", "find"), ("isopod", "isopod"),
        ("茶壶在哪里", "茶壶在哪里"), ("👨‍👩‍👧", "👨‍👩‍👧"),
    ],
)  # fmt: skip
def test_noun_phrases(text: str, phrase: str) -> None:
    assert noun_phrase(text) == phrase


@given(st.text(min_size=1, max_size=60))
def test_a_noun_phrase_is_stable_and_not_empty(text: str) -> None:
    phrase = noun_phrase(text)
    assert phrase or not text.split()
    assert noun_phrase(phrase) == phrase


@pytest.mark.parametrize(
    ("text", "heads", "details"),
    [
        ("Where is the mug?", ["mug"], []),
        ("the mug on the table", ["mug"], [("on", "table", False)]),
        ("a glass of water", ["glass"], [("of", "water", False)]),
        ("a glass full of water", ["glass"], [("full of", "water", False)]),
        ("kettle without a lid", ["kettle"], [("without", "lid", True)]),
        ("the kettle without a lid on the stove", ["kettle"], [("without", "lid", True), ("on", "stove", False)]),
        ("mug but not the cup", ["mug"], [("but not", "cup", True)]),
        ("no mug", [], [("no", "mug", True)]),
        ("man wearing a hat", ["man"], [("wearing", "hat", False)]),
        ("fork, knife and a spoon", ["fork", "knife", "spoon"], []),
        ("fork and knife next to the plates", ["fork", "knife"], [("next to", "plates", False)]),
        ("what is on the bed?", [], [("on", "bed", False)]),
        ("mug on", ["mug"], [("on", "", False)]),
        ("ofen", ["ofen"], []),
        ("茶壶", ["茶壶"], []),
    ],
)
def test_phrases_are_taken_apart(text: str, heads: list[str], details: list[tuple[str, str, bool]]) -> None:
    phrase = parse_noun_phrase(text)
    assert list(phrase.heads) == heads
    assert [(detail.connector, " ".join(detail.groups), detail.negated) for detail in phrase.details] == details
    assert bool(phrase.tail) == bool(details) and phrase.text.endswith(phrase.tail)


@given(st.text(st.sampled_from("a bcdnotwihfr,.?'-"), min_size=1, max_size=60))
def test_any_text_can_be_taken_apart(text: str) -> None:
    phrase = parse_noun_phrase(text)
    for group in (*phrase.heads, *(group for detail in phrase.details for group in detail.groups)):
        assert group and noun_groups(group) == (group,)
        modifiers, head = split_modifiers(group)
        assert head or not modifiers


@pytest.mark.parametrize(
    ("group", "modifiers", "head"),
    [
        ("red mugs", {"red"}, "mug"),
        ("two big red mugs", {"two", "big", "red"}, "mug"),
        ("light blue mug", {"light", "blue"}, "mug"),
        ("light switch", set(), "light switch"),
        ("coffee mug", set(), "coffee mug"),
        ("orange", set(), "orange"),
        ("orange juice", {"orange"}, "juice"),
        ("red", set(), "red"),
        ("wooden horse", set(), "wooden horse"),
        ("hot dog", set(), "hot dog"),
    ],
)
def test_plain_modifiers_come_off(group: str, modifiers: set[str], head: str) -> None:
    assert split_modifiers(group) == (modifiers, head)
