"""What is inside a question, and what is not a question."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.service.query.names import candidate_names, check_texts, noun_phrase
from fastsplat_contract.errors import FastSplatError, InvalidInputError, LimitExceededError


@pytest.mark.parametrize(
    ("text", "phrase"),
    [
        ("the mug", "mug"),
        ("a coffee machine", "coffee machine"),
        ("Where is the mug?", "mug"),
        ("where's my mug", "mug"),
        ("WHERE ARE THE SPOONS?!", "SPOONS"),
        ("please find me the coffee machine", "coffee machine"),
        ("is there a mug here?", "mug"),
        ("Is the mug in this room?", "mug"),
        ("show me all of the mugs, please", "mugs"),
        ('"mug"', "mug"),
        ("  mug \n", "mug"),
        ("the", "the"),
        ("where is", "where is"),
        ("?!", "?!"),
        ("where is the", "the"),
        ("theatre", "theatre"),
        ("find", "find"),
        ("isopod", "isopod"),
        ("茶壶在哪里", "茶壶在哪里"),
        ("👨‍👩‍👧", "👨‍👩‍👧"),
    ],
)
def test_noun_phrases(text: str, phrase: str) -> None:
    assert noun_phrase(text) == phrase


@given(st.text(min_size=1, max_size=60))
def test_a_noun_phrase_is_stable_and_not_empty(text: str) -> None:
    phrase = noun_phrase(text)
    assert phrase or not text.split()
    assert noun_phrase(phrase) == phrase


def test_the_head_comes_last() -> None:
    assert list(candidate_names("Where is the mug on the table?")) == [
        "Where is the mug on the table?",
        "mug on the table",
        "mug",
    ]


def test_a_label_that_begins_like_a_question_is_found_literally() -> None:
    assert next(iter(candidate_names("the thing"))) == "the thing"


@pytest.mark.parametrize(
    ("texts", "error"),
    [
        ([], InvalidInputError),
        ("mug", InvalidInputError),
        (b"mug", InvalidInputError),
        (None, InvalidInputError),
        ([""], InvalidInputError),
        (["  \t\n"], InvalidInputError),
        (["\u200b\u00a0"], InvalidInputError),
        (["mug", ""], InvalidInputError),
        (["mu\x00g"], InvalidInputError),
        (["mug\x1b[31m"], InvalidInputError),
        (["\ud800"], InvalidInputError),
        ([3], InvalidInputError),
        ([None], InvalidInputError),
        (["x" * 100_000], LimitExceededError),
        (["mug"] * 65, LimitExceededError),
    ],
)
def test_what_cannot_be_asked(texts: Any, error: type[FastSplatError]) -> None:
    with pytest.raises(error) as caught:
        check_texts(texts, max_texts=64, max_chars=1000)
    assert caught.value.hint
    assert (error is LimitExceededError) == bool(caught.value.limit)


@pytest.mark.parametrize("text", ["🧸", "茶壶", "чайник", "إبريق", "x" * 1000, "a\tmug", "👨‍👩‍👧", "Ünïcödé"])
def test_what_can_be_asked(text: str) -> None:
    check_texts([text], max_texts=64, max_chars=1000)
