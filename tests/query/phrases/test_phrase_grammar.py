"""What is said of an object in a question, and what a hostile text costs."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.query.language.words.name_matching import NameIndex
from fastsplat.service.query.phrases.phrase_grammar import (
    MARKERS,
    MAX_CONDITIONS,
    MAX_WORDS,
    parse_question,
    parsed_questions,
)
from fastsplat.service.query.phrases.phrases import Condition, Phrase, Possession, Relation, Says


def _written(phrase: Phrase) -> str:
    """A phrase in brackets: "mug red on(table) size>1"."""
    words = [phrase.head or "*", *(color.text for color in phrase.colors), *(size.word for size in phrase.sizes)]
    for condition in phrase.conditions:
        said = ", ".join(_written(anchor) for anchor in _anchors(condition))
        kind, said = ("says", condition.words) if isinstance(condition, Says) else (condition.kind, said)
        words.append(f"{'not ' if condition.negated else ''}{kind}({said})")
    if (rank := phrase.rank) is not None:
        of = f"({_written(rank.anchors[0])})" if rank.anchors else ""
        words.append(f"{rank.by}{'>' if rank.descending else '<'}{rank.number}{of}")
    return " ".join(words)


def _anchors(condition: Condition) -> tuple[Phrase, ...]:
    if isinstance(condition, Possession):
        return (condition.phrase,)
    return condition.anchors if isinstance(condition, Relation) else ()


@pytest.mark.parametrize(
    "text",
    [
        *("mug", "the mugs", "coffee machine", "wooden horse", "hot dog", "orange", "old mug", "where is the mug?"),
        *("something to drink from", "object you put on your head", "light for reading", "a pair of scissors"),
        *("object that keeps time", "wipe up a spill", "fork and knife", "no chair", "mug, not the glass", "?!", "the"),
        *("something to write in", "place to put books on", "Tasse auf dem Tisch", "茶壶在哪里", "object", "red"),
    ],
)
def test_names_and_descriptions_are_left_as_they_are(text: str) -> None:
    assert parse_question(text) is None


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("the red mug", "mug red"), ("a light blue kettle", "kettle light blue"), ("something red", "* red"),
        ("what is red?", "* red"), ("the mug that is not red", "mug not red"),
        ("red object to drink from", "object to drink from red"), ("picture of a dog", "picture of(dog)"),
        ("glass of water", "glass of(water)"), ("cup without a handle", "cup not with(handle)"),
        ("cup with no handle", "cup not with(handle)"), ("is the mug on the table?", "mug on(table)"),
        ("what is under the table?", "* under(table)"), ("mugs that are not on the table", "mugs not on(table)"),
        ("the pair of scissors in the box", "pair of scissors in(box)"),
        ("the mug left of the lamp", "mug left_of(lamp)"),
        ("the mug to the right of the red lamp", "mug right_of(lamp red)"),
        ("the chair in front of me", "chair in_front_of()"),
        ("the mug between the lamp and the book", "mug between(lamp, book)"),
        ("what is between the two lamps?", "* between(two lamps)"), ("the largest bottle", "bottle size>1"),
        ("the second smallest bottle", "bottle size<2"), ("which of the mugs is tallest?", "mugs height>1"),
        ("the big mug", "mug big"), ("nearest mug", "mug distance<1"),
        ("the nearest mug to the lamp", "mug distance<1(lamp)"),
        ("which chair is farthest from the table?", "chair distance>1(table)"),
        ("the mug closest to me", "mug distance<1"), ("second mug from the left", "mug from_left<2"),
        ("which mug is second from the right?", "mug from_left>2"), ("the cup on the left", "cup from_left<1"),
        ("the rightmost cup", "cup from_left>1"),
        ("the mug on the table and next to the lamp", "mug on(table) next_to(lamp)"),
        ("how many mugs are on the table?", "mugs on(table)"),
        ("How many mugs do you see on the table", "mugs on(table)"),
    ],
)  # fmt: skip
def test_phrases_are_taken_apart(text: str, meant: str) -> None:
    question = parse_question(text)
    assert question is not None and question.not_understood == ""
    assert question.asks == ("count" if "ow many" in text else "objects")
    assert [_written(reading) for reading in question.readings] == [meant]


def test_what_comes_after_an_object_may_be_said_of_it() -> None:
    question = parse_question("the mug on the table next to the lamp")
    assert question is not None
    assert [_written(reading) for reading in question.readings] == [
        "mug on(table) next_to(lamp)",
        "mug on(table next_to(lamp))",
    ]


@pytest.mark.parametrize(
    ("text", "left_over"),
    [
        ("the mug on the table that my aunt gave me", "that my aunt gave me"),
        ("the chair at the table", "at the table"),
        ("the third mug on the table", "number 3"),
        ("a mug on a table in a box by a lamp", "by a lamp"),
    ],
)
def test_what_is_not_understood_is_said(text: str, left_over: str) -> None:
    question = parse_question(text)
    assert question is not None and question.not_understood == left_over


def test_a_name_of_the_dictionary_is_no_phrase() -> None:
    names = NameIndex(dictionary_of(["can of paint", "red scissors", "mug"]))
    texts = ["a can of paint", "the red scissors", "blue scissors", "red mug"]
    assert [question is None for question in parsed_questions(texts, names)] == [True, True, False, False]


_CLOSED = {word for marker in MARKERS for word in marker}
_WORDS = st.sampled_from(sorted(_CLOSED | {"mug", "red", "second", "and", "the"}))


@given(st.lists(_WORDS, min_size=1, max_size=2 * MAX_WORDS).map(" ".join) | st.text(max_size=1_000))
@example("on the " * 300)
@example("mug " + "on the table next to the lamp " * 8)
def test_any_text_costs_little(text: str) -> None:
    question = parse_question(text)
    if question is None:
        return
    assert 1 <= len(question.readings) <= 14 and len(text.split()) <= MAX_WORDS + 8
    assert len({reading.head for reading in question.readings}) == 1
    for reading in question.readings:
        assert _depth(reading) <= MAX_CONDITIONS + 1


def _depth(phrase: Phrase) -> int:
    inner = [anchor for condition in phrase.conditions for anchor in _anchors(condition)]
    inner += [] if phrase.rank is None else phrase.rank.anchors
    return 1 + max(map(_depth, inner), default=0)
